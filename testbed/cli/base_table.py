"""The table that a calibrated slope is written into: that of the run, or of the mapping."""

from collections.abc import Sequence
from pathlib import Path

from msgspec import structs

from testbed.cli.refusal import warn
from testbed.config import load
from testbed.core.table import Table
from testbed.identification.mapping import load_mapping
from testbed.identification.table_file import load_table
from testbed.logs.log_reader import log_of


def table_of(paths: Sequence[Path], mapping: str | None) -> Table:
    """The table of the run, or a level one of the size in the mapping."""
    config = log_of(paths[0]).parent / "config.toml" if mapping is None else None
    if config is not None and config.is_file():
        return load(config).table
    base, named = load_table(None), load_mapping(mapping).table if mapping else None
    if named is None:
        size = f"{base.size[0]:g} m x {base.size[1]:g} m"
        warn([f"the mapping has no `table`: the table file gets {size}; correct its `size`"])
        return base
    return structs.replace(base, size=(float(named[0]), float(named[1])))


def tilted(table: Table, slope: list[float]) -> Table:
    """The table with this uniform slope [m/s^2]."""
    tilt = structs.replace(table.tilt, uniform=(slope[0], slope[1]), map=[])
    return structs.replace(table, tilt=tilt)
