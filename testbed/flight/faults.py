"""The fault table: what is watched, how long it may last, what is done about it.

A row holds when its detector's number is above or below the row's bound for `misses` ticks in a
row and for `timeout_s`. Of all rows that hold the most severe response is taken. A latched one
stays until an explicit reset.

`warn`   say so
`hold`   come to rest and wait; go on when it is over
`brake`  stop relative to the table within what the jets can do, then close every valve
`coast`  close every valve at once and drift
`land`   close every valve and shut the air off, the bearings' too
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
    "poses_rejected",  # of late, by the estimator
    "setpoint_age",  # [s] since the newest setpoint was due
    "setpoint_overdue",  # [s] since the newest setpoint ran out
    "neighbour_age",  # [s] of the oldest state heard of another vehicle
    "supply_share",  # supply pressure over set pressure
    "tank_loss",  # [1/s] share of a full tank that goes per second
    "battery",  # [V]
    "board_silent",  # [s]
    "jet_open",  # share of its thrust that a jet gives without a command
    "jet_leaks",  # standard deviations from a jet that gives nothing without a command
    "jet_leaks_or_weak",  # the same, where a jet that gives too little may explain it as well
    "jet_missing",  # standard deviations by which a jet gives too little
    "spare_room",  # [m] left after a full stop, to the nearest thing ahead
    "law_error",  # 1: the law died of an exception
    "not_a_number",  # 1: law or tracker asks for something that is none
    "tick_late",  # [s]
    "operator_age",  # [s] since the operator's presence was last heard
    "clock_offset",  # [s] between host and vehicle, either way
    "config_differs",  # 1: host and vehicle do not have the same configuration
    "disk_free",  # [bytes]
    "foreign",  # messages of another session since the last tick
    "fleet",  # 1: another vehicle has a fault that stops all
]
DETECTORS: tuple[str, ...] = get_args(Detector)


class Fault(Struct, frozen=True, forbid_unknown_fields=True):
    """One row."""

    detector: Detector
    response: Response
    text: str  # for the operator; `{value:.2f}` is the detector's number, `{said}` its words
    latched: bool
    above: float | None = None  # the row holds above this
    below: float | None = None  # or below this; one of the two is given
    misses: Annotated[int, Meta(ge=1)] = 1  # ticks in a row
    timeout_s: NonNegative = 0.0  # and for so long

    def __post_init__(self) -> None:
        if (self.above is None) == (self.below is None):
            raise ValueError("expected one of `above` and `below`, found both or neither")
        if not _is_plain(self.text):
            raise ValueError("expected a text with {value} and {said} only, found another field")


def _is_plain(text: str) -> bool:
    """Whether a text can be filled in whatever the detector says, and stays one line or two."""
    try:
        for _, field, how, _ in Formatter().parse(text):
            # a format that is itself filled in, or as wide as a book, shows only in flight
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
    """The response that wins; empty: none."""
    return max(responses, key=SEVERITY.__getitem__, default="")
