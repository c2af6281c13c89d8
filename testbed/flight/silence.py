"""Whose silence it is: a vehicle that hears nothing at all has lost its own link.

Setpoints, the operator's presence and the states of the other vehicles arrive over one link. If
only one of them is missing, its sender is silent. If all of them ended at about the same time, the
vehicle's own link ended, or the host that relays all of them.
"""

from collections.abc import Iterable

from testbed.core.codes import Detector, FaultReport
from testbed.core.rows import numbers_of
from testbed.core.types import Inputs
from testbed.flight.faults import Fault

SHARE = 0.5  # of the longest silence: a shorter one began at another time
LINK = "link_lost"  # as configs/faults.toml calls it
SENDERS = (Detector.NEIGHBOUR_AGE.words, Detector.OPERATOR_AGE.words)


def silences(inputs: Inputs) -> dict[str, float]:
    """How long each sender has not been heard at a tick [s]; those that never spoke are left out.

    On the twin the operator's presence is no message: then its age is 0.
    """
    found = {name: inputs.t - one.t for name, one in inputs.neighbours.items()}
    if inputs.setpoint is not None:
        found["setpoints"] = inputs.t - numbers_of(inputs.setpoint)[1]
    if inputs.vitals.operator_age > 0.0:
        found["the operator"] = inputs.vitals.operator_age
    return found


def hears_nothing(silent: dict[str, float]) -> bool:
    """Whether all senders, two or more, fell silent at about the same time."""
    longest = max(silent.values(), default=0.0)
    return len(silent) > 1 and min(silent.values()) > SHARE * longest


def blame_link(
    report: FaultReport, rows: Iterable[tuple[str, Fault]], inputs: Inputs
) -> FaultReport:
    """The lost link as the fault of a vehicle that hears nothing; otherwise the same fault.

    Args:
        report: of the row that has ended the flight.
        rows: of the fault table. Without a row for lost setpoints that latches, nothing changes.
        inputs: of the tick.
    """
    links = (
        name for name, one in rows if one.measures == Detector.SETPOINT_OVERDUE and one.latched
    )
    silent, link = silences(inputs), next(links, "")
    if report.detector not in SENDERS or not link or not hears_nothing(silent):
        return report
    return lost(report, silent_for(silent), link)


def silent_for(silent: dict[str, float]) -> str:
    """What a vehicle says that hears none of these senders."""
    return f"nothing heard for {min(silent.values()):.2f} s from {', '.join(sorted(silent))}"


def lost(report: FaultReport, words: str, link: str = LINK) -> FaultReport:
    """A lost link in place of another fault, of which the words stay as a note."""
    text, notes = f"{link.replace('_', ' ')}: {words}", (report.words, *report.notes)
    return FaultReport(link, text, report.vehicle, report.detector, report.value, None, notes)
