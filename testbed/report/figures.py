"""The figures of a run, and the corresponding figures of the paper."""

from collections.abc import Iterator, Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from testbed.config.experiment import Experiment
from testbed.core.path import heading_at
from testbed.logs.history import History
from testbed.metrics.run_metrics import HOLD_S, ROUNDING_S, Touch, Track
from testbed.report.fault_story import EventLine
from testbed.report.goal_error import GoalError, goal_at
from testbed.report.item import WIDTH, Box, Chart, Item, Limit, Line, Moment, Raster
from testbed.report.marking import crosses_of, moments_of, with_events
from testbed.report.table_figures import enumerated, near, phases, trajectory
from testbed.report.valves import openings

Array = NDArray[np.float64]

MOST_PAIRS = 6  # of vehicles drawn as one line per pair
HISTOGRAM = 40  # bins
PAPERS = {  # corresponding figures of the papers
    "zhang2023": {
        "trajectory": "Figure 15", "error_xy": "Figure 16", "error": "Figure 16",
        "tracking": "Figure 18",
    },
}  # fmt: skip


def figures(
    scenario: Experiment, history: History, touches: Sequence[Touch] = (),
    events: Sequence[EventLine] = (),
) -> list[Chart]:  # fmt: skip
    """All applicable figures, in the order of the report, with contacts and events marked."""
    makers = (
        trajectory, near, phases, _error, _error_xy, _tracking, _heading, _distances,
        _separations, _speed,
        _force, _valves, _air, _timing, _pose_to_valve, _filter,
    )  # fmt: skip
    made = [chart for maker in makers for chart in maker(scenario, history)]
    shown = [chart for chart in made if any(_shows(item) for item in chart.items)]
    moments = moments_of(history, touches, events)
    crosses = crosses_of(history, touches, events)
    return [with_events(chart, moments, crosses) for chart in shown]


def _shows(item: Item) -> bool:
    """Whether an item shows data: a limit alone does not."""
    match item:
        case Line(_, y):
            return bool(np.isfinite(y).any())
        case Limit() | Moment():
            return False
    return True


def analogue(scenario: Experiment, key: str) -> str:
    """Text naming the paper's figure that this one corresponds to; empty if there is none."""
    paper = scenario.name.partition("_")[0]
    figure = PAPERS.get(paper, {}).get(key)
    return f"the analogue of {figure} in {paper}" if figure else ""


def _time(history: History) -> tuple[float, float]:
    return 0.0, max(history.end, 1e-3)


def _error(scenario: Experiment, history: History) -> Iterator[Chart]:
    goal_error, (t, places) = GoalError(scenario), history.together()
    settled = 1e3 * goal_error.settled_m
    items: list[Item] = [Limit(settled, f"settled below {settled:.0f} mm")]
    hold, shape = scenario.criteria.hold_rms_m, scenario.criteria.formation
    period = scenario.flight.jet_period_s  # after the last tick
    if hold is not None and history.end + period > HOLD_S - ROUNDING_S:
        items.append(Limit(1e3 * hold, f"hold RMS limit {1e3 * hold:g} mm"))
    if shape is not None and shape.error_m is not None:
        limit = 1e3 * shape.error_m
        items.append(Limit(limit, f"limit at the end {limit:g} mm"))
    for k, (name, off) in enumerate(goal_error.parts(t, places).items()):
        items.append(Line(t, 1e3 * off, k, name))
    yield Chart("error", goal_error.title, "time [s]", "distance [mm], log scale",
                items, _time(history), log=True)  # fmt: skip


def _error_xy(scenario: Experiment, history: History) -> Iterator[Chart]:
    items: list[Item] = []
    if GoalError(scenario).forms:
        return  # vehicles have no individual goals
    for k, name, _ in enumerated(history):
        t, state = history.where(name)
        off = state[:, :2] - goal_at(scenario.vehicles[name], t)
        items += [
            Line(t, off[:, 0], k, f"{name} x"),
            Line(t, off[:, 1], k, "y", "dashed", f"{name} y"),
        ]
    yield Chart("error_xy", "Relative position error", "time [s]", "error [m]", items,
                _time(history))  # fmt: skip


def _interpolated(history: History, name: str) -> tuple[Array, Array, Array]:
    """Times, and the true poses and references at these times."""
    vehicle = history.vehicles[name]
    t, state = history.where(name)
    known = ~np.isnan(vehicle.at) & ~np.isnan(vehicle.reference[:, 2])
    if len(t) < 2 or not known.any():
        return np.zeros(0), np.zeros((0, 3)), np.zeros((0, 3))
    known &= vehicle.at <= t[-1]
    at = vehicle.at[known]
    return at, Track(t, state[:, None]).at(at, 0), vehicle.reference[known]


def _tracking(scenario: Experiment, history: History) -> Iterator[Chart]:
    items: list[Item] = []
    limit = scenario.criteria.track_rms_m
    for k, name, vehicle in enumerated(history):
        if not np.isnan(vehicle.force_asked).all():
            continue  # commanded by force, without a reference
        at, pose, asked = _interpolated(history, name)
        items.append(Line(at, 1e3 * np.hypot(*(pose - asked)[:, :2].T), k, name))
    if items and limit is not None:
        items.append(Limit(1e3 * limit, f"RMS limit {1e3 * limit:g} mm"))
    yield Chart("tracking", "Tracking error: distance to the reference", "time [s]",
                "error [mm]", items, _time(history))  # fmt: skip


def _heading(scenario: Experiment, history: History) -> Iterator[Chart]:
    items: list[Item] = []
    for k, name, _ in enumerated(history):
        t, state = history.where(name)
        setup = scenario.vehicles[name]
        goal = [heading_at(setup.path, setup.goal[2], one) for one in t.tolist()]
        off = np.angle(np.exp(1j * (state[:, 2] - np.array(goal))))
        items.append(Line(t, np.degrees(off), k, name))
    yield Chart("heading", "Heading error to the goal", "time [s]", "angle [deg]", items,
                _time(history), height=170)  # fmt: skip


def _distances(scenario: Experiment, history: History) -> Iterator[Chart]:
    items: list[Item] = []
    radii = sorted({obstacle.radius for obstacle in scenario.obstacles.values()})
    for k, name, _ in enumerated(history):
        t, state = history.where(name)
        gaps = [
            np.hypot(*(state[:, :2] - np.array(r.position) - np.outer(t, r.velocity)).T) - r.radius
            for r in scenario.obstacles.values()
        ]
        if gaps:
            items.append(Line(t, np.min(gaps, axis=0), k, name))
    if items:
        which = f"{radii[0]:g} m" if len(radii) == 1 else "each its own"
        items.append(Limit(0.0, f"danger radius ({which})"))
    yield Chart("obstacles", "Distance of a vehicle's centre to the nearest danger zone",
                "time [s]", "distance [m]", items, _time(history))  # fmt: skip


def _separations(scenario: Experiment, history: History) -> Iterator[Chart]:
    names, items = list(history.vehicles), []
    pairs = [(a, b) for i, a in enumerate(names) for b in names[i + 1 :]]
    if len(pairs) > MOST_PAIRS:
        yield _nearest(scenario, history)
        return
    for k, (a, b) in enumerate(pairs):
        (t, first), (_, second) = history.where(a), history.where(b)
        n = min(len(first), len(second))
        gap = np.hypot(*(first[:n, :2] - second[:n, :2]).T)
        items.append(Line(t[:n], gap, k, f"{a}, {b}"))
    limits = [_touch(scenario)] if items else []
    yield Chart("separation", "Distance between vehicles, centre to centre", "time [s]",
                "distance [m]", [*items, *limits], _time(history), height=190)  # fmt: skip


def _touch(scenario: Experiment) -> Limit:
    radii = sorted(setup.model.radius for setup in scenario.vehicles.values())
    touch = radii[-1] + radii[-2]
    return Limit(touch, f"touch, {touch:g} m")


def _nearest(scenario: Experiment, history: History) -> Chart:
    """Separation of many vehicles: one line per vehicle instead of per pair."""
    t, places = history.together()
    items: list[Item] = [
        Line(t, np.min([np.hypot(*(place - other).T) for whose, other in places.items()
                        if whose != name], axis=0), k, name)
        for k, (name, place) in enumerate(places.items())
        if len(places) > 1
    ]  # fmt: skip
    title = "Distance to the nearest other vehicle, centre to centre"
    items.append(_touch(scenario))
    return Chart("separation", title, "time [s]", "distance [m]", items, _time(history), height=190)


def _speed(scenario: Experiment, history: History) -> Iterator[Chart]:
    items: list[Item] = []
    for k, name, _ in enumerated(history):
        t, state = history.where(name)
        items.append(Line(t, 1e3 * np.hypot(*state[:, 3:5].T), k, name))
    yield Chart("speed", "Speed", "time [s]", "speed [mm/s]", items, _time(history),
                height=170)  # fmt: skip


def _smooth(values: Array, width: int) -> Array:
    if len(values) < width:
        return values
    kernel = np.ones(width) / width
    inner = np.convolve(values, kernel, mode="same")
    count = np.convolve(np.ones(len(values)), kernel, mode="same")
    return inner / count


def _force(scenario: Experiment, history: History) -> Iterator[Chart]:
    items: list[Item] = []
    width = max(1, round(1.0 / scenario.flight.jet_period_s))
    for k, name, v in enumerated(history):
        commanded = np.hypot(
            _smooth(v.commanded_wrench[:, 0], width), _smooth(v.commanded_wrench[:, 1], width)
        )
        given = np.hypot(
            _smooth(v.realised_wrench[:, 0], width), _smooth(v.realised_wrench[:, 1], width)
        )
        items.append(Line(v.t, given, k, "", "thin dashed", f"{name} delivered"))
        items.append(Line(v.t, commanded, k, name, hint=f"{name} demanded"))
    yield Chart("force", "Force demanded and delivered", "time [s]", "force [N]", items,
                _time(history), note="Means over 1 s. Delivered (thin, dashed): computed "
                "from the pulses and the jet table.")  # fmt: skip


def _valves(scenario: Experiment, history: History) -> Iterator[Chart]:
    rows: list[Item] = []
    names: list[tuple[float, str]] = []
    for k, name, v in enumerated(history):
        delay = scenario.vehicles[name].model.command_delay_s
        for jet in range(v.on.shape[1]):
            row = -(k * (v.on.shape[1] + 1) + jet)
            names.append((row + 0.5, f"{name} {jet + 1}"))
            rows.append(Raster(row, *openings(v, jet, delay), k))
    yield Chart("valves", "Valves: when each jet was open", "time [s]", "vehicle and jet", rows,
                _time(history), y_ticks=names, height=11 * len(rows) + 12,
                width=2 * WIDTH)  # fmt: skip


def _air(scenario: Experiment, history: History) -> Iterator[Chart]:
    tank: list[Item] = []
    supply: list[Item] = []
    for k, name, v in enumerated(history):
        if np.any(v.tank > 0.0):  # otherwise it has no pressure gauge
            tank.append(Line(v.t, v.tank / 1e6, k, name))
        if np.any(v.supply > 0.0):
            supply.append(Line(v.t, v.supply / 1e3, k, name))
    yield Chart("tank", "Tank pressure", "time [s]", "pressure [MPa]", tank,
                _time(history), height=160)  # fmt: skip
    yield Chart("supply", "Supply pressure behind the regulator", "time [s]", "pressure [kPa]",
                supply, _time(history), height=140)  # fmt: skip


def largest_each_second(t: Array, values: Array) -> tuple[Array, Array]:
    """The largest value of each second; a number that jumps every tick would fill the figure."""
    seconds, start = np.unique(np.floor(t), return_index=True)
    return seconds, np.fmax.reduceat(values, start) if len(t) else values


def _timing(scenario: Experiment, history: History) -> Iterator[Chart]:
    poses: list[Item] = [
        Line(*largest_each_second(v.t, 1e3 * v.pose_age), k, name)
        for k, name, v in enumerated(history)
    ]
    limit = scenario.flight.gate.pose_timeout_s
    worst = max((float(np.nanmax(v.pose_age, initial=0.0)) for v in history.vehicles.values()),
                default=0.0)  # fmt: skip
    if worst > 0.5 * limit:
        poses.append(Limit(1e3 * limit, f"limit {1e3 * limit:g} ms"))
    yield Chart("pose_age", "Age of the newest pose, when the plan takes effect", "time [s]",
                "age [ms]", poses, _time(history), height=150,
                note="The largest of each second.")  # fmt: skip
    ages: list[Item] = [
        Line(t, 1e3 * age, k, name) for k, (name, (t, age)) in enumerate(history.state_ages.items())
    ]
    for k, name, v in enumerated(history):
        if len(v.wires):
            ages.append(Line(v.wires[:, 0], 1e3 * v.wires[:, 2], k, f"to {name}", "thin dashed"))
    yield Chart("link", "Link: age of the newest state at the host", "time [s]",
                "age [ms]", ages, _time(history), height=150)  # fmt: skip
    loop: list[Item] = []
    if len(history.loop):
        loop = [Line(history.loop[:, 0], 1e3 * history.loop[:, 1], 0, "late"),
                Line(history.loop[:, 0], 1e3 * history.loop[:, 2], 1, "busy")]  # fmt: skip
    for k, name, v in enumerated(history):
        if len(v.wires):
            loop.append(Line(v.wires[:, 0], 1e3 * v.wires[:, 1], k + 2, name))
    yield Chart("loop", "Lateness of the loop", "time [s]", "time [ms]", loop, _time(history),
                height=150)  # fmt: skip


def _pose_to_valve(scenario: Experiment, history: History) -> Iterator[Chart]:
    """How long the newest poses took from their arrival to the plan on the wire."""
    taken = [v.wires[:, 4] for v in history.vehicles.values() if v.wires.shape[1] > 4]
    found = 1e3 * np.concatenate(taken) if taken else np.zeros(0)
    found = found[np.isfinite(found)]
    if not len(found):
        return
    low, high = 0.0, float(found.max()) * 1.05 + 1e-9
    counts, edges = np.histogram(found, HISTOGRAM, (low, high))
    total, items = len(found), list[Item]()
    for n, (a, b) in zip(counts.tolist(), pairwise(edges.tolist()), strict=True):
        hint = f"{a:.2f} to {b:.2f} ms: {n} of {total}"
        if n:
            items.append(Box((a, b), (0.0, 100.0 * n / total), "good", hint))
    for share, name in ((50, "median"), (99, "99 %")):
        value = float(np.percentile(found, share))
        items.append(Moment(value, f"{name} {value:.2f} ms"))
    yield Chart("pose_to_valve", "From the newest pose to the valves' plan", "time [ms]",
                "share [%]", items, (low, high), (0.0, 105.0 * int(counts.max()) / total),
                height=150, note="From a pose's arrival at the vehicle to the first byte of its "
                "plan to the board.")  # fmt: skip


def _filter(scenario: Experiment, history: History) -> Iterator[Chart]:
    items: list[Item] = [
        Line(v.t, np.hypot(*v.filtered.T), k, name)
        for k, name, v in enumerated(history)
        if np.any(v.filtered)
    ]
    yield Chart("filter", "Force change by the safety filter", "time [s]", "force [N]", items,
                _time(history), height=150)  # fmt: skip
