"""The shipped configuration files, and the default fault table."""

from functools import cache
from pathlib import Path

import msgspec

from testbed.config.tree import read_toml
from testbed.flight.faults import FaultTable

SHIPPED = Path(__file__).resolve().parents[2] / "configs"
FAULTS = SHIPPED / "faults.toml"


@cache
def shipped_faults() -> FaultTable:
    """The table of configs/faults.toml."""
    return msgspec.convert(read_toml(FAULTS), FaultTable)
