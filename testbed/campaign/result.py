"""All runs of a campaign as one table, and as one Parquet file."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from testbed.campaign.row import FlownRun
from testbed.campaign.sweep import Campaign
from testbed.core.extra import needs_extra
from testbed.files import atomic_write

Table = dict[str, list[Any]]


def table_of(campaign: Campaign, runs: Sequence[FlownRun]) -> Table:
    """Columns of equal length, one entry per run, in the order of the runs.

    First the parameters that were set and drawn, named as in the campaign file; then the outcome;
    then the numbers. Computing times are left out, so the table depends only on the file.
    """
    ordered = sorted(runs, key=lambda run: run.k)
    parameters = [campaign.parameters(run.k) for run in ordered]
    table: Table = {"run": [run.k for run in ordered]}
    for name in parameters[0] if parameters else ():
        column = [row[name] for row in parameters]
        kinds = {type(value) for value in column}
        mixed = len(kinds - {int, float}) > 0 and len(kinds) > 1
        table[name] = [str(value) for value in column] if mixed else column
    table["outcome"] = [run.outcome for run in ordered]
    table["reason"] = [run.reason for run in ordered]
    for name in dict.fromkeys(name for run in ordered for name in run.criteria):
        table[f"met.{name}"] = [run.criteria.get(name) for run in ordered]
    for name in dict.fromkeys(name for run in ordered for name in run.columns):
        table[name] = [run.columns.get(name) for run in ordered]
    return table


def write_parquet(path: Path, table: Table, facts: dict[str, str]) -> None:
    """Write the table as a Parquet file, atomically."""
    with needs_extra("campaign"):
        import pyarrow
        from pyarrow import parquet
    numbers = {
        name: pyarrow.array(column, pyarrow.float64())
        if any(isinstance(value, float) for value in column)
        or all(value is None for value in column)  # an untyped column matches no other campaign's
        else pyarrow.array(column)
        for name, column in table.items()
    }
    arrow = pyarrow.table(numbers).replace_schema_metadata(facts)
    with atomic_write(path) as part:
        parquet.write_table(arrow, part, compression="zstd")
