"""Marks the events of a flight in its figures: lines over time, crosses on the table."""

from collections.abc import Sequence

import numpy as np
from msgspec.structs import replace

from testbed.logs.history import History
from testbed.metrics.run_metrics import Touch
from testbed.report.chart import TIME
from testbed.report.fault_story import EventLine
from testbed.report.item import Chart, Item, Moment, Point

APART = 0.01  # of the flight: events nearer to each other share one line
MOST_EVENTS = 12  # mild ones that are marked


def with_events(chart: Chart, moments: Sequence[Item], crosses: Sequence[Item]) -> Chart:
    """Add lines at the events, or on the table crosses at their places."""
    if chart.x_label == TIME:
        return replace(chart, items=[*chart.items, *moments])
    if chart.key != "trajectory" or not crosses:
        return chart
    note = chart.note + " Red stars are contacts, red crosses the places of faults."
    return replace(chart, items=[*chart.items, *crosses], note=note)


def moments_of(
    history: History, touches: Sequence[Touch], events: Sequence[EventLine]
) -> list[Item]:
    """A line at each contact, each vehicle's own fault, and the first mild events."""
    named = [(one.t, f"{one.vehicle} hits {one.other}") for one in touches]
    named += [(one.t, f"{', '.join(one.who)}: {fault_in(one.words)}") for one in _faults(events)]
    times: dict[float, str] = {}
    for t, words in named:
        if all(abs(t - other) > APART * history.end for other in times):
            times[t] = "" if words in times.values() else words  # each is named once
    mild = [one.t for one in events if one.level == "WARN" and one.t > 0.5][:MOST_EVENTS]
    return [*(Moment(t, words) for t, words in times.items()),
            *(Moment(t, "", "mild") for t in dict.fromkeys(mild))]  # fmt: skip


def _faults(events: Sequence[EventLine]) -> list[EventLine]:
    """Faults of the vehicles that are the culprits."""
    return [one for one in events if one.level == "CRITICAL" and one.words.startswith("fault: ")]


def fault_in(words: str) -> str:
    """The name of a fault in the text of its event."""
    return words.removeprefix("fault: ").partition(":")[0].replace("_", " ")


def crosses_of(
    history: History, touches: Sequence[Touch], events: Sequence[EventLine]
) -> list[Item]:
    """A star at each contact, a cross where a vehicle had its fault."""
    found: list[Item] = []
    first = {one.vehicle: one.t for one in reversed(touches)}
    for one in touches:
        name = f"contact, {one.t:.1f} s" if one.t == first[one.vehicle] else ""
        found.append(Point(*_place(history, one.vehicle, one.t), 0, "hit", name, 0.25))
    for fault in _faults(events):
        for who in fault.who:
            if who in history.vehicles and who not in first:
                name = f"{fault_in(fault.words)}, {fault.t:.1f} s"
                found.append(Point(*_place(history, who, fault.t), 0, "fault", name, 0.25))
    return found


def _place(history: History, name: str, t: float) -> tuple[float, float]:
    times, state = history.where(name)
    if not len(times):
        return float("nan"), float("nan")
    return float(np.interp(t, times, state[:, 0])), float(np.interp(t, times, state[:, 1]))
