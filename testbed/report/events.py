"""The report's list of events: contacts, faults, interventions, without repetition."""

from collections.abc import Sequence
from html import escape

from testbed.config.experiment import Experiment
from testbed.logs.history import History
from testbed.metrics.run_metrics import Touch
from testbed.report.fault_story import RANK, SUPERVISOR, EventLine, Story
from testbed.report.verdict import hit

SHOWN = 40  # most lines in the list
REPEATED = 3  # repetitions from which an event becomes one line
HOW_MARKED = (
    '<p class="soft">Figures over time have dotted lines at warnings, dashed ones at contacts, '
    'faults and forks. <span class="on-screen">A click on an event or a figure shows that time in '
    "all of them.</span></p>"
)
LOOKS = {"CRITICAL": "not", "ERROR": "not", "WARN": "warn", "INFO": ""}


def lines(scenario: Experiment, history: History, touches: Sequence[Touch]) -> list[EventLine]:
    """Events in order of time; repeated ones are merged."""
    rows = [(name, one) for name, vehicle in history.vehicles.items() for one in vehicle.events]
    rows += [(SUPERVISOR, one) for one in history.phases]
    events = Story(scenario).lines_of(rows)
    events += [EventLine(t.t, (t.vehicle,), "CRITICAL", hit(scenario, t)) for t in touches]
    return sorted(gathered(events), key=lambda one: (one.t, RANK.index(one.level)))


def gathered(lines: list[EventLine]) -> list[EventLine]:
    """Merge repeated events into one line, at the time of the first."""
    often: dict[tuple[str, str], list[EventLine]] = {}
    for one in lines:
        often.setdefault((one.level, one.words), []).append(one)
    found = []
    for (level, words), same in often.items():
        count = sum(len(one.who) for one in same)
        if level not in ("WARN", "INFO") or len(same) < REPEATED:
            found += same
            continue
        who = tuple(dict.fromkeys(name for one in same for name in one.who))
        first, last = same[0].t, same[-1].t
        summary = f"{count} x {words}, first {first:.1f} s, last {last:.1f} s"
        found.append(EventLine(first, who, same[0].level, summary))
    return found


def happened(events: Sequence[EventLine]) -> str:
    """The report's section of faults and interventions, as HTML."""
    rows = [_row(one) for one in events]
    if not rows:
        return "<h2>Faults and interventions</h2><p>None.</p>"
    if (more := len(rows) - SHOWN) > 0:  # keep the first and the last lines
        half = SHOWN // 2
        rest = f'<td></td><td></td><td class="words soft">{more} more, in the log</td>'
        rows = [*rows[:half], f"<tr>{rest}</tr>", *rows[-half:]]
    return (
        f'<h2>Faults and interventions</h2>{HOW_MARKED}<div class="wide"><table><tr>'
        '<th>time [s]</th><th class="words">vehicle</th><th class="words">event</th></tr>'
        f"{''.join(rows)}</table></div>"
    )


def _row(one: EventLine) -> str:
    look = LOOKS[one.level]
    words = f'<span class="{look}">{escape(one.words)}</span>' if look else escape(one.words)
    who = escape(", ".join(one.who))
    return (
        f'<tr data-t="{one.t:.2f}" tabindex="0"><td>{one.t:.1f}</td><td class="words">{who}</td>'
        f'<td class="words">{words}</td></tr>'
    )
