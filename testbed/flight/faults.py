"""The fault table: detectors, thresholds, durations and responses.

A row holds when its detector's number is above or below the row's bound for `misses` ticks in a
row and for `timeout_s`. The most severe response of all rows that hold is taken. A latched
response stays until an explicit reset. A row with the response "reconfigure" takes its jet out of
the allocation, or compensates for it, and does not latch while the jets left suffice.
"""

from string import Formatter
from typing import Annotated, Literal

from msgspec import Meta, Struct

from testbed.core.codes import (
    Detector,
    DetectorName,
    FaultCause,
    FaultReport,
    Response,
    ResponseName,
)
from testbed.core.error import MismatchError
from testbed.core.vehicle import NonNegative

LONGEST_FORMAT = 6  # characters after the colon, as in {value:>9.2e}
OF_A_JET = (
    Detector.JET_OPEN, Detector.JET_LEAKS, Detector.JET_LEAKS_OR_WEAK, Detector.JET_MISSING,
)  # fmt: skip
LONGEST_WORDS = 300  # longest text of a detector [characters]: it is sent over the network


class Fault(Struct, frozen=True, forbid_unknown_fields=True):
    """One row of the fault table."""

    detector: DetectorName  # see `codes.Detector`
    response: ResponseName | Literal["reconfigure"]  # see `codes.Response`, and reconfiguration.py
    text: str  # for the operator; `{value:.2f}` is the detector's number, `{said}` its text
    latched: bool
    above: float | None = None  # the row holds above this
    below: float | None = None  # or below this; one of the two is given
    misses: Annotated[int, Meta(ge=1)] = 1  # ticks in a row
    timeout_s: NonNegative = 0.0  # and for at least this long
    otherwise: ResponseName = "brake"  # for "reconfigure", if the jets left do not suffice

    def __post_init__(self) -> None:
        if (self.above is None) == (self.below is None):
            raise MismatchError("one of `above` and `below`", "both or neither")
        if not _is_plain(self.text):
            raise MismatchError("a text with {value} and {said} only", "another field")
        if self.reconfigures and self.measures not in OF_A_JET:
            raise MismatchError('"reconfigure" for a detector of jets', self.detector)

    @property
    def code(self) -> Response:
        """Number of the row's response, for compiled code; of "reconfigure", the second choice."""
        return Response[(self.otherwise if self.reconfigures else self.response).upper()]

    @property
    def reconfigures(self) -> bool:
        """Whether the vehicle flies on with the other jets, if they suffice."""
        return self.response == "reconfigure"

    @property
    def measures(self) -> Detector:
        """Number of the row's detector, for compiled code."""
        return Detector[self.detector.upper()]

    def report(self, name: str, value: float, said: str, cause: FaultCause | None) -> FaultReport:
        """The report of this row `name`; `said` is the detector's text."""
        value = float(value)  # some are integers, which {value:.3} rejects
        text = self.text.format(value=value, said=said[:LONGEST_WORDS])
        return FaultReport(name, text, "", self.detector, value, cause)


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
