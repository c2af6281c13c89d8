"""What a vehicle has noticed during a flight that went on."""

from collections.abc import Mapping

from msgspec import Struct

from testbed.core.law import Concern


class Warned(Struct, frozen=True):
    """A row of the fault table that held."""

    t: float  # for the first time [s]
    number: float  # of its detector, when it was farthest beyond the bound
    words: str  # its text at that time


def noticed(vehicles: Mapping[str, Mapping[str, Warned]]) -> list[Concern]:
    """A warning for each row that has held on each vehicle; rows by their names."""
    return [
        Concern(row, f"{name}: {one.words} (from {one.t:.1f} s)")
        for name, rows in vehicles.items()
        for row, one in rows.items()
    ]
