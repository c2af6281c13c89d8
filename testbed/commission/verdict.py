"""The verdict of one step on one vehicle."""

from msgspec import Struct


class Verdict(Struct, frozen=True):
    """What a step found; without a code all is well."""

    step: str
    vehicle: str
    text: str
    code: str = ""  # what is wrong, such as "wires_swapped"
    numbers: dict[str, float] = {}  # SI units, in the names where they are others
    skipped: bool = False
