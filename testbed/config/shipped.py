"""The shipped configuration files, and the default fault table."""

from functools import cache
from pathlib import Path

import msgspec

from testbed.config.thresholds import resolved, take_texts, words_of
from testbed.config.tree import read_toml
from testbed.core.table import Table
from testbed.core.vehicle import Vehicle
from testbed.flight.faults import FaultTable
from testbed.flight.guidance import GuidanceParams
from testbed.flight.parameters import FlightParams

SHIPPED = Path(__file__).resolve().parents[2] / "configs"
FAULTS = SHIPPED / "faults.toml"


@cache
def shipped(kind: str) -> dict[str, Path]:
    """The shipped files of a kind, such as "experiments" or "vehicles", by name."""
    return {file.stem: file for file in sorted((SHIPPED / kind).glob("*.toml"))}


@cache
def shipped_faults() -> FaultTable:
    """The table of configs/faults.toml, for the shipped vehicle on the shipped table."""
    tree = read_toml(FAULTS)
    texts = take_texts(tree)
    vehicle = msgspec.convert(read_toml(SHIPPED / "vehicles" / "generic_8jet.toml"), Vehicle)
    table = msgspec.convert(read_toml(SHIPPED / "tables" / "marble_6m.toml"), Table)
    words = words_of([vehicle], table, FlightParams(), GuidanceParams())
    return resolved(msgspec.convert(tree, FaultTable), texts, words)
