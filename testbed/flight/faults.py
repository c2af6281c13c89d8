"""The fault table: detectors, thresholds, durations and responses.

A row holds when its detector's number is above or below the row's bound for `misses` ticks in a
row and for `timeout_s`. The most severe response of all rows that hold is taken. A latched
response stays until an explicit reset.

`warn`   report it
`hold`   come to rest and wait; continue when the row no longer holds
`brake`  stop relative to the table with the force of the jets, then close every valve
`coast`  close every valve at once and drift
`land`   close every valve and turn the air off, including the bearings'
"""

from string import Formatter
from typing import Annotated, Literal, get_args

from msgspec import Meta, Struct

from testbed.core.vehicle import NonNegative

Response = Literal["warn", "hold", "brake", "coast", "land"]
LONGEST_FORMAT = 6  # characters after the colon, as in {value:>9.2e}
SEVERITY = {name: k for k, name in enumerate(("", *get_args(Response)))}

Detector = Literal[
    "pose_age",  # [s] since the newest accepted pose was captured
    "pose_repeats",  # equal poses in a row
    "pose_jump",  # [m] of the newest pose from where it was expected
    "pose_of_another",  # 1: the newest pose is where another vehicle should be
    "poses_rejected",  # recently, by the estimator
    "setpoint_age",  # [s] since the newest setpoint was due
    "setpoint_overdue",  # [s] since the newest setpoint expired
    "neighbour_age",  # [s] age of the state of the vehicle not heard for longest
    "supply_share",  # supply pressure over set pressure
    "tank_loss",  # [1/s] share of a full tank lost per second
    "battery",  # [V]
    "board_silent",  # [s]
    "jet_open",  # share of its thrust that a jet gives without a command
    "jet_leaks",  # standard deviations from a jet without thrust while not commanded
    "jet_leaks_or_weak",  # the same, if a weak jet may explain it as well
    "jet_missing",  # standard deviations by which a jet is too weak
    "spare_room",  # [m] left after a full stop, to the nearest hazard
    "law_error",  # 1: the law raised an exception
    "not_a_number",  # 1: the output of law or tracker is not finite
    "tick_late",  # [s]
    "operator_age",  # [s] since the operator's presence was last heard
    "clock_offset",  # [s] between host and vehicle, absolute
    "config_differs",  # 1: host and vehicle do not have the same configuration
    "disk_free",  # [bytes]
    "foreign",  # messages of another session since the last tick
    "fleet",  # 1: another vehicle has a fault that stops all vehicles
]
DETECTORS: tuple[str, ...] = get_args(Detector)


class Fault(Struct, frozen=True, forbid_unknown_fields=True):
    """One row of the fault table."""

    detector: Detector
    response: Response
    text: str  # for the operator; `{value:.2f}` is the detector's number, `{said}` its text
    latched: bool
    above: float | None = None  # the row holds above this
    below: float | None = None  # or below this; one of the two is given
    misses: Annotated[int, Meta(ge=1)] = 1  # ticks in a row
    timeout_s: NonNegative = 0.0  # and for at least this long

    def __post_init__(self) -> None:
        if (self.above is None) == (self.below is None):
            raise ValueError("expected one of `above` and `below`, found both or neither")
        if not _is_plain(self.text):
            raise ValueError("expected a text with {value} and {said} only, found another field")


def _is_plain(text: str) -> bool:
    """Whether a text can be formatted with any detector value, and stays short."""
    try:
        for _, field, how, _ in Formatter().parse(text):
            # a nested or very wide format would fail only in flight
            if field is not None and (field not in ("value", "said") or not _is_short(how or "")):
                return False
        text.format(value=0.0, said="")
    except (KeyError, IndexError, ValueError, AttributeError):
        return False
    return True


def _is_short(how: str) -> bool:
    return len(how) <= LONGEST_FORMAT and "{" not in how


FaultTable = dict[str, Fault]


def most_severe(responses: list[Response]) -> str:
    """The most severe response; empty: none."""
    return max(responses, key=SEVERITY.__getitem__, default="")
