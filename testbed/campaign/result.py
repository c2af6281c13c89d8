"""All runs of a campaign as one table, and as one Parquet file."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from testbed.campaign.extra import needs_extra
from testbed.campaign.row import Flown
from testbed.campaign.sweep import Campaign
from testbed.files import atomic_write

Table = dict[str, list[Any]]


def table_of(campaign: Campaign, runs: Sequence[Flown]) -> Table:
    """Columns of equal length, one entry per run, in the order of the runs.

    What was set and drawn comes first, under the names of the campaign file; then how the run
    ended; then its numbers. Times of computing are not in it: the table depends on the file alone.
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
    """The table as a Parquet file, whole or not at all."""
    with needs_extra("campaign"):
        import pyarrow
        from pyarrow import parquet
    numbers = {
        name: pyarrow.array(column, pyarrow.float64())
        if any(isinstance(value, float) for value in column)
        or all(value is None for value in column)  # a column of no type fits no other campaign's
        else pyarrow.array(column)
        for name, column in table.items()
    }
    arrow = pyarrow.table(numbers).replace_schema_metadata(facts)
    with atomic_write(path) as part:
        parquet.write_table(arrow, part, compression="zstd")
