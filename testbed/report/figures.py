"""The figures of a run, and the corresponding figures of the paper."""

from collections.abc import Iterator, Sequence

import numpy as np
from msgspec.structs import replace
from numpy.typing import NDArray

from controllers.graph import LEADER
from testbed.config.experiment import Experiment
from testbed.logs.history import History, VehicleHistory
from testbed.metrics.run_metrics import HOLD_S, Touch, Track
from testbed.report.goal_error import GoalError, goal_at
from testbed.report.item import WIDTH, Chart, Disc, Item, Limit, Line, Moment, Point, Raster

Array = NDArray[np.float64]

MOST_PAIRS = 6  # of vehicles drawn as one line per pair
GHOSTS = 9  # instants at which the vehicles are drawn along their tracks
WITH_TOUCHES = ("error", "obstacles", "separation", "speed")  # figures over time
PAPERS = {  # corresponding figures of the papers
    "zhang2023": {
        "trajectory": "Figure 15", "error_xy": "Figure 16", "error": "Figure 16",
        "tracking": "Figure 18",
    },
}  # fmt: skip


def figures(scenario: Experiment, history: History, touches: Sequence[Touch] = ()) -> list[Chart]:
    """All applicable figures, in the order of the report, with contacts marked."""
    makers = (
        _trajectory, _error, _error_xy, _tracking, _heading, _distances, _separations, _speed,
        _force, _valves, _air, _timing, _filter,
    )  # fmt: skip
    made = [chart for maker in makers for chart in maker(scenario, history)]
    shown = [chart for chart in made if any(_shows(item) for item in chart.items)]
    return [_with_touches(chart, history, touches) for chart in shown]


def _with_touches(chart: Chart, history: History, touches: Sequence[Touch]) -> Chart:
    """Add markers of contacts to a figure."""
    marks: list[Item] = []
    if chart.key == "trajectory":
        for one in touches:
            t, state = history.where(one.vehicle)
            x, y = (float(np.interp(one.t, t, state[:, i])) for i in (0, 1))
            marks.append(Point(x, y, 0, "hit"))
    elif chart.key in WITH_TOUCHES:
        times: dict[float, str] = {}
        for one in touches:  # simultaneous contacts share one line
            if all(abs(one.t - t) > 0.01 * history.end for t in times):
                times[one.t] = f"{one.vehicle} hits {one.other}"
        marks += [Moment(t, words) for t, words in times.items()]
    note = chart.note + " Red stars are contacts." * (bool(marks) and chart.key == "trajectory")
    return replace(chart, items=[*chart.items, *marks], note=note)


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


def _vehicles(history: History) -> Iterator[tuple[int, str, VehicleHistory]]:
    for k, (name, vehicle) in enumerate(history.vehicles.items()):
        yield k, name, vehicle


def _trajectory(scenario: Experiment, history: History) -> Iterator[Chart]:
    items: list[Item] = []
    goal_error = GoalError(scenario)
    has_goals = not goal_error.forms
    for obstacle in scenario.obstacles.values():
        (x, y), (vx, vy) = obstacle.position, obstacle.velocity
        items.append(Disc(x, y, obstacle.radius, "danger"))
        if obstacle.solid > 0.0:
            items.append(Disc(x, y, obstacle.solid, "solid"))
        if vx or vy:
            t = np.linspace(0.0, history.end, 400)
            way = np.stack([x + t * vx, y + t * vy], axis=1)
            way = way[(np.abs(way) <= np.array(scenario.table.size) / 2).all(axis=1)]
            items.append(Line(way[:, 0], way[:, 1], 0, "", "way dashed"))
    for k, name, vehicle in _vehicles(history):
        setup = scenario.vehicles[name]
        asked = vehicle.reference
        items.append(Line(asked[:, 0], asked[:, 1], k, "", "thin dashed"))
        t, state = history.where(name)
        items.append(Line(state[:, 0], state[:, 1], k, name))
        for i in np.linspace(0, len(t) - 1, GHOSTS).astype(int) if len(t) else ():
            items.append(
                Disc(float(state[i, 0]), float(state[i, 1]), setup.model.radius, "ghost", k)
            )
        (x, y, _), room = setup.start, setup.model.radius
        items.append(Point(x, y, k, "ring", "" if has_goals else name, room))
        if has_goals:
            x, y = goal_at(setup, np.array([history.end]))[0].tolist()
            items.append(Point(x, y, k, "cross", name, room))
    if goal_error.led:
        led = goal_error.leader_at(np.linspace(0.0, history.end, 200))
        hue = len(history.vehicles)
        items.append(Line(led[:, 0], led[:, 1], hue, "", "dashed"))
        items.append(Point(float(led[-1, 0]), float(led[-1, 1]), hue, "cross", "leader"))
    ends = {n: s[-1, :2] for n in history.vehicles if len(s := history.where(n)[1])}
    if goal_error.led:
        ends[LEADER] = goal_error.leader_at(np.array([history.end]))[0]
    for a, b, _ in goal_error.edges:
        if a in ends and b in ends:
            x, y = np.stack([ends[a], ends[b]]).T
            items.append(Line(x, y, 0, "", "edge"))
    half_x, half_y = scenario.table.size[0] / 2, scenario.table.size[1] / 2
    note = "Rings are starts"
    note += ", crosses are goals" * has_goals + ", the cross is the leader" * goal_error.led
    note += "; grey lines are the formation's edges at the end" * bool(goal_error.edges)
    note += f"; circles are the vehicles to scale at {GHOSTS} times"
    if not all(np.isnan(v.reference).all() for v in history.vehicles.values()):
        note += "; thin dashed lines are the references"
    if any(obstacle.velocity != (0.0, 0.0) for obstacle in scenario.obstacles.values()):
        note += "; obstacles are drawn at their start, their paths as dashed red lines"
    if scenario.obstacles:
        note += "; dashed red circles are danger radii for the vehicle's centre"
    note += "."
    yield Chart("trajectory", "Trajectories on the table", "x [m]", "y [m]", items,
                (-half_x, half_x), (-half_y, half_y), equal=True, note=note)  # fmt: skip


def _error(scenario: Experiment, history: History) -> Iterator[Chart]:
    goal_error, (t, places) = GoalError(scenario), history.together()
    settled = 1e3 * goal_error.settled_m
    items: list[Item] = [Limit(settled, f"settled below {settled:.0f} mm")]
    hold, shape = scenario.criteria.hold_rms_m, scenario.criteria.formation
    if hold is not None and history.end > HOLD_S:
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
    for k, name, _ in _vehicles(history):
        t, state = history.where(name)
        off = state[:, :2] - goal_at(scenario.vehicles[name], t)
        items += [Line(t, off[:, 0], k, f"{name} x"), Line(t, off[:, 1], k, "y", "dashed")]
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
    for k, name, vehicle in _vehicles(history):
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
    for k, name, _ in _vehicles(history):
        t, state = history.where(name)
        off = np.angle(np.exp(1j * (state[:, 2] - scenario.vehicles[name].goal[2])))
        items.append(Line(t, np.degrees(off), k, name))
    yield Chart("heading", "Heading error to the goal", "time [s]", "angle [deg]", items,
                _time(history), height=170)  # fmt: skip


def _distances(scenario: Experiment, history: History) -> Iterator[Chart]:
    items: list[Item] = []
    radii = sorted({obstacle.radius for obstacle in scenario.obstacles.values()})
    for k, name, _ in _vehicles(history):
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
    for k, name, _ in _vehicles(history):
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
    for k, name, v in _vehicles(history):
        commanded = np.hypot(
            _smooth(v.commanded_wrench[:, 0], width), _smooth(v.commanded_wrench[:, 1], width)
        )
        given = np.hypot(
            _smooth(v.realised_wrench[:, 0], width), _smooth(v.realised_wrench[:, 1], width)
        )
        items.append(Line(v.t, given, k, "", "thin dashed"))
        items.append(Line(v.t, commanded, k, f"{name} demanded"))
    yield Chart("force", "Force demanded and delivered", "time [s]", "force [N]", items,
                _time(history), note="Means over 1 s. Delivered (thin, dashed): computed "
                "from the pulses and the jet table.")  # fmt: skip


def openings(edges: Array, jet: int) -> tuple[Array, Array]:
    """Times and durations [s] of a jet's openings, from its board's edges (t, mask)."""
    is_open = (edges[:, 1].astype(int) >> jet) & 1
    before = np.concatenate([[0], is_open[:-1]])
    starts = edges[(is_open == 1) & (before == 0), 0]
    ends = edges[(is_open == 0) & (before == 1), 0]
    return starts[: len(ends)], ends - starts[: len(ends)]


def _valves(scenario: Experiment, history: History) -> Iterator[Chart]:
    rows: list[Item] = []
    names: list[tuple[float, str]] = []
    for k, name, v in _vehicles(history):
        delay = scenario.vehicles[name].model.command_delay_s
        for jet in range(v.on.shape[1]):
            row = -(k * (v.on.shape[1] + 1) + jet)
            names.append((row + 0.5, f"{name} {jet + 1}"))
            if len(v.edges):  # its board reports output edges
                starts, lengths = openings(v.edges, jet)
                rows.append(Raster(row, starts, lengths, k))
                continue
            open_ = v.on[:, jet] > 0.0
            start = v.t[open_] + delay + v.offset[open_, jet]
            rows.append(Raster(row, start, v.on[open_, jet], k))
    yield Chart("valves", "Valves: when each jet was open", "time [s]", "vehicle and jet", rows,
                _time(history), y_ticks=names, height=11 * len(rows) + 12,
                width=2 * WIDTH)  # fmt: skip


def _air(scenario: Experiment, history: History) -> Iterator[Chart]:
    tank: list[Item] = []
    supply: list[Item] = []
    for k, name, v in _vehicles(history):
        if np.any(v.tank > 0.0):  # otherwise it has no pressure gauge
            tank.append(Line(v.t, v.tank / 1e6, k, name))
        if np.any(v.supply > 0.0):
            supply.append(Line(v.t, v.supply / 1e3, k, name))
    yield Chart("tank", "Tank pressure", "time [s]", "pressure [MPa]", tank,
                _time(history), height=160)  # fmt: skip
    yield Chart("supply", "Supply pressure behind the regulator", "time [s]", "pressure [kPa]",
                supply, _time(history), height=140)  # fmt: skip


def _timing(scenario: Experiment, history: History) -> Iterator[Chart]:
    poses: list[Item] = [Line(v.t, 1e3 * v.pose_age, k, name) for k, name, v in _vehicles(history)]
    limit = scenario.flight.gate.pose_timeout_s
    worst = max((float(np.nanmax(v.pose_age, initial=0.0)) for v in history.vehicles.values()),
                default=0.0)  # fmt: skip
    if worst > 0.5 * limit:
        poses.append(Limit(1e3 * limit, f"limit {1e3 * limit:g} ms"))
    yield Chart("pose_age", "Age of the newest pose, when the plan takes effect", "time [s]",
                "age [ms]", poses, _time(history), height=150)  # fmt: skip
    heard: list[Item] = [
        Line(t, 1e3 * age, k, name) for k, (name, (t, age)) in enumerate(history.heard.items())
    ]
    for k, name, v in _vehicles(history):
        if len(v.wires):
            heard.append(Line(v.wires[:, 0], 1e3 * v.wires[:, 2], k, f"to {name}", "thin dashed"))
    yield Chart("link", "Link: age of the newest state at the host", "time [s]",
                "age [ms]", heard, _time(history), height=150)  # fmt: skip
    loop: list[Item] = []
    if len(history.loop):
        loop = [Line(history.loop[:, 0], 1e3 * history.loop[:, 1], 0, "late"),
                Line(history.loop[:, 0], 1e3 * history.loop[:, 2], 1, "busy")]  # fmt: skip
    for k, name, v in _vehicles(history):
        if len(v.wires):
            loop.append(Line(v.wires[:, 0], 1e3 * v.wires[:, 1], k, name, "thin"))
    yield Chart("loop", "Lateness of the loop", "time [s]", "time [ms]", loop, _time(history),
                height=150)  # fmt: skip


def _filter(scenario: Experiment, history: History) -> Iterator[Chart]:
    items: list[Item] = [
        Line(v.t, np.hypot(*v.filtered.T), k, name)
        for k, name, v in _vehicles(history)
        if np.any(v.filtered)
    ]
    yield Chart("filter", "Force change by the safety filter", "time [s]", "force [N]", items,
                _time(history), height=150)  # fmt: skip
