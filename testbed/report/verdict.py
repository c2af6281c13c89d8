"""The verdict on a run: a sentence, its colour, and the metrics that failed.

Green: all criteria met. Amber: a criterion missed, or not started. Red: a fault ended it, or there
was a contact. Grey: not judged: stopped by an operator, killed, or without criteria.
"""

from collections.abc import Sequence
from typing import Literal, NamedTuple

from testbed.config.experiment import Experiment
from testbed.config.unmeasured import without_number
from testbed.core.codes import FaultId
from testbed.metrics.run_metrics import Metrics, Touch

UNCOUNTED = -1  # contacts of a run that was killed before they were counted
SHOWN_TOUCHES = 3
NOTHING_TO_JUDGE = "no criteria to judge"  # of a completed run
NOTHING_MEASURED = " (nothing was measured)"  # behind a criterion that is not met
CRITERIA = {  # name, unit, scale from the unit of the file
    "max_contacts": ("contacts", "", 1.0), "clear_of_obstacles": ("danger radii kept", "", 1.0),
    "final_error_m": ("final error", "mm", 1e3), "settle_s": ("settled", "s", 1.0),
    "hold_rms_m": ("hold RMS, last 30 s", "mm", 1e3),
    "track_rms_m": ("tracking RMS", "mm", 1e3), "heading_rms_deg": ("heading RMS", "deg", 1.0),
    "impulse_ns": ("impulse", "N s", 1.0),
    "formation.error_m": ("formation, error at the end", "mm", 1e3),
    "formation.settled_s": ("formation settled", "s", 1.0),
    "formation.longest_edge_m": ("longest edge", "m", 1.0),
}  # fmt: skip

Look = Literal["passed", "failed", "fault", "unjudged"]


class RunVerdict(NamedTuple):
    """Text of the verdict and its colour."""

    look: Look
    words: str


def verdict(scenario: Experiment, metrics: Metrics) -> RunVerdict:
    """Sentence and colour for the outcome of a run."""
    end = f"{metrics.duration_s:.1f} s"
    if metrics.contacts == UNCOUNTED:
        return RunVerdict("unjudged", f"not judged, {end} in the log")
    if metrics.red:
        return RunVerdict("failed", "not started: a check failed")
    hits = touched(scenario, metrics.touches[:1])
    report = metrics.fault_report
    if report is not None and report.id == FaultId.STOPPED and not hits:
        return RunVerdict("unjudged", f"{report.text} after {end}: not judged")
    if metrics.fault:
        if not hits and report is not None and report.vehicle in scenario.vehicles:
            hits = [f"{report.vehicle}: {report.title}"]
        return RunVerdict("fault", "; ".join([*hits, f"aborted by a fault after {end}"]))
    if not metrics.completed:
        return RunVerdict("unjudged", "; ".join([*hits, f"interrupted at {end}: not judged"]))
    missed = [k for k, met in (metrics.criteria or {}).items() if not met]
    names = [
        CRITERIA.get(k, (k,))[0] + NOTHING_MEASURED * unmeasured(scenario, metrics, k)
        for k in missed
        if not (hits and k == "max_contacts")
    ]
    if missed:
        words = f"failed: {'; '.join([*hits, *names])}"
        return RunVerdict("fault" if "max_contacts" in missed else "failed", words)
    if not metrics.criteria:
        return RunVerdict("unjudged", NOTHING_TO_JUDGE)
    return RunVerdict("passed", "passed")


def touched(scenario: Experiment, touches: Sequence[Touch]) -> list[str]:
    """One sentence per contact, in order of time."""
    return [
        f"{one.vehicle} hit {_other(scenario, one)} at {one.t:.1f} s, {_speed(one)}"
        for one in touches
    ]


def hit(scenario: Experiment, touch: Touch) -> str:
    """Object and speed of a contact, as text."""
    return f"hit {_other(scenario, touch)}, {_speed(touch)}"


def _other(scenario: Experiment, touch: Touch) -> str:
    if touch.other in scenario.obstacles:
        return f"obstacle {touch.other}"
    return touch.other if touch.other in scenario.vehicles else f"the table's {touch.other}"


def _speed(touch: Touch) -> str:
    return f"{100.0 * touch.speed:.0f} cm/s"


def reasons(scenario: Experiment, metrics: Metrics) -> list[str]:
    """Short reasons why the run did not pass, the most important first."""
    found = touched(scenario, metrics.touches[:SHOWN_TOUCHES])
    if (more := len(metrics.touches) - SHOWN_TOUCHES) > 0:
        found.append(f"{more} more {'contacts' if more > 1 else 'contact'}")
    found += [one.words for one in metrics.red]
    report = metrics.fault_report
    stopped = report is not None and report.id == FaultId.STOPPED
    if metrics.fault and not metrics.red and not stopped:
        if report is None or report.vehicle not in scenario.vehicles:
            found.append(metrics.fault)
        elif any(t.vehicle == report.vehicle for t in metrics.touches):
            found.append(f"{report.vehicle}: {report.title}, after the contact")
        else:
            found.append(f"{report.vehicle}: {report.text}")
    return found


def missed(scenario: Experiment, metrics: Metrics, name: str, key: str, criterion: str) -> bool:
    """Whether this vehicle's metric violates a criterion."""
    if (metrics.criteria or {}).get(criterion) is not False:
        return False
    value = getattr(metrics.vehicles[name], key)
    if criterion == "clear_of_obstacles":
        # with several radii, only a distance below the smallest certainly violates one
        return value is not None and value < min(o.radius for o in scenario.obstacles.values())
    limit = getattr(scenario.criteria, criterion)
    return value is None or limit is None or value > limit


def unmeasured(scenario: Experiment, metrics: Metrics, criterion: str) -> bool:
    """Whether a criterion has no value, as hold RMS in a 20 s run. "never settled" is a value."""
    if criterion.startswith("formation."):
        found, key = metrics.formation, criterion.removeprefix("formation.")
        looked_at = "error_m" if key == "settled_s" else key
        return getattr(found, looked_at, None) is None
    if any(criterion in without_number(scenario, name) for name in metrics.vehicles):
        return True
    if criterion in ("settle_s", "clear_of_obstacles"):
        return False
    return any(getattr(m, criterion, 0.0) is None for m in metrics.vehicles.values())
