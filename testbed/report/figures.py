"""The figures of a run, and the corresponding figures of the paper."""

from collections.abc import Iterator, Sequence
from itertools import pairwise

import numpy as np
from msgspec.structs import replace
from numpy.typing import NDArray

from controllers.graph import LEADER
from testbed.config.experiment import Experiment
from testbed.logs.history import History, VehicleHistory
from testbed.metrics.run_metrics import HOLD_S, Touch, Track
from testbed.report.chart import TIME
from testbed.report.fault_story import Said
from testbed.report.goal_error import GoalError, curves, goal_at
from testbed.report.item import WIDTH, Box, Chart, Disc, Item, Limit, Line, Moment, Point, Raster
from testbed.report.valves import openings

Array = NDArray[np.float64]

SMALL = 0.25  # of the table: motion in less than this is drawn enlarged
PHASE_WIDTH = 400  # of a figure of one phase; letters are larger in it
MOST_PAIRS = 6  # of vehicles drawn as one line per pair
GHOSTS = 9  # instants at which the vehicles are drawn along their tracks
HISTOGRAM = 40  # bins
APART = 0.01  # of the flight: events nearer to each other share one line
MOST_EVENTS = 12  # mild ones that are marked
PAPERS = {  # corresponding figures of the papers
    "zhang2023": {
        "trajectory": "Figure 15", "error_xy": "Figure 16", "error": "Figure 16",
        "tracking": "Figure 18",
    },
}  # fmt: skip


def figures(
    scenario: Experiment, history: History, touches: Sequence[Touch] = (),
    told: Sequence[Said] = (),
) -> list[Chart]:  # fmt: skip
    """All applicable figures, in the order of the report, with contacts and events marked."""
    makers = (
        _trajectory, _near, _phases, _error, _error_xy, _tracking, _heading, _distances,
        _separations, _speed,
        _force, _valves, _air, _timing, _pose_to_valve, _filter,
    )  # fmt: skip
    made = [chart for maker in makers for chart in maker(scenario, history)]
    shown = [chart for chart in made if any(_shows(item) for item in chart.items)]
    moments = _moments(history, touches, told)
    crosses = _crosses(history, touches, told)
    return [_with_events(chart, moments, crosses) for chart in shown]


def _with_events(chart: Chart, moments: Sequence[Item], crosses: Sequence[Item]) -> Chart:
    """Add lines at the events, or on the table crosses at their places."""
    if chart.x_label == TIME:
        return replace(chart, items=[*chart.items, *moments])
    if chart.key != "trajectory" or not crosses:
        return chart
    note = chart.note + " Red stars are contacts, red crosses the places of faults."
    return replace(chart, items=[*chart.items, *crosses], note=note)


def _moments(history: History, touches: Sequence[Touch], told: Sequence[Said]) -> list[Item]:
    """A line at each contact, each vehicle's own fault, and the first mild events."""
    named = [(one.t, f"{one.vehicle} hits {one.other}") for one in touches]
    named += [(one.t, f"{', '.join(one.who)}: {fault_in(one.words)}") for one in _faults(told)]
    times: dict[float, str] = {}
    for t, words in named:
        if all(abs(t - other) > APART * history.end for other in times):
            times[t] = "" if words in times.values() else words  # each is named once
    mild = [one.t for one in told if one.level == "WARN" and one.t > 0.5][:MOST_EVENTS]
    return [*(Moment(t, words) for t, words in times.items()),
            *(Moment(t, "", "mild") for t in dict.fromkeys(mild))]  # fmt: skip


def _faults(told: Sequence[Said]) -> list[Said]:
    """Faults of the vehicles that are the culprits."""
    return [one for one in told if one.level == "CRITICAL" and one.words.startswith("fault: ")]


def fault_in(words: str) -> str:
    """The name of a fault in the text of its event."""
    return words.removeprefix("fault: ").partition(":")[0].replace("_", " ")


def _crosses(history: History, touches: Sequence[Touch], told: Sequence[Said]) -> list[Item]:
    """A star at each contact, a cross where a vehicle had its fault."""
    found: list[Item] = []
    first = {one.vehicle: one.t for one in reversed(touches)}
    for one in touches:
        name = f"contact, {one.t:.1f} s" if one.t == first[one.vehicle] else ""
        found.append(Point(*_place(history, one.vehicle, one.t), 0, "hit", name, 0.25))
    for said in _faults(told):
        for who in said.who:
            if who in history.vehicles and who not in first:
                name = f"{fault_in(said.words)}, {said.t:.1f} s"
                found.append(Point(*_place(history, who, said.t), 0, "fault", name, 0.25))
    return found


def _place(history: History, name: str, t: float) -> tuple[float, float]:
    times, state = history.where(name)
    if not len(times):
        return float("nan"), float("nan")
    return float(np.interp(t, times, state[:, 0])), float(np.interp(t, times, state[:, 1]))


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


def _near(scenario: Experiment, history: History) -> Iterator[Chart]:
    """The place of the motion enlarged, with headings, where it is small beside the table."""
    paths = [history.where(name)[1] for name in history.vehicles]
    flown = np.concatenate([one[:, :2] for one in paths]) if paths else np.zeros((0, 2))
    if not len(flown):
        return
    low, high = flown.min(axis=0), flown.max(axis=0)
    half = max(0.6 * float((high - low).max()), 0.01)
    if 2.0 * half > SMALL * min(scenario.table.size):
        return
    middle, items = (low + high) / 2, list[Item]()
    for k, (name, state) in enumerate(zip(history.vehicles, paths, strict=True)):
        items.append(Line(state[:, 0], state[:, 1], k, name))
        for i in np.linspace(0, len(state) - 1, GHOSTS).astype(int) if len(state) else ():
            (x, y), turn = state[i, :2], state[i, 2]
            arm = 0.12 * half
            items.append(Line(np.array([x, x + arm * np.cos(turn)]),
                              np.array([y, y + arm * np.sin(turn)]), k, "", "thin"))  # fmt: skip
        setup = scenario.vehicles[name]
        items.append(Point(*setup.start[:2], k, "ring"))
        items.append(Point(*setup.goal[:2], k, "cross"))
    span = [(float(m) - half, float(m) + half) for m in middle]
    yield Chart("near", "The motion, enlarged", "x [m]", "y [m]", items, span[0], span[1],
                equal=True, note=f"The ring is the start, the cross the goal; strokes are the "
                f"headings at {GHOSTS} times.")  # fmt: skip


def _phases(scenario: Experiment, history: History) -> Iterator[Chart]:
    """One small table per phase of a law whose formation changes, with the phase's curve."""
    phases = getattr(scenario.controller, "phases", ())
    if len(phases) < 2:
        return
    half_x, half_y = scenario.table.size[0] / 2, scenario.table.size[1] / 2
    centre = getattr(scenario.controller, "centre", None) or (0.0, 0.0)
    ends = [*(phase.at for phase in phases[1:]), history.end]
    for n, (phase, end) in enumerate(zip(phases, ends, strict=True), 1):
        items: list[Item] = []
        for x, y in curves(phase.shape) if phase.shape else ():
            items.append(Line(centre[0] + x, centre[1] + y, 0, "", "way dashed"))
        for k, name, _ in _vehicles(history):
            t, state = history.where(name)
            state = state[(t >= phase.at) & (t <= end)]
            if len(state):
                items.append(Line(state[:, 0], state[:, 1], k, name))
                radius = scenario.vehicles[name].model.radius
                items.append(Disc(float(state[-1, 0]), float(state[-1, 1]), radius, "ghost", k))
        if phase.at < history.end:
            shape = (phase.shape or "field").replace("_", " ")
            title = f"Phase {n}: {shape}, {phase.at:.0f} to {min(end, history.end):.0f} s"
            yield Chart(f"phase_{n}", title, "x [m]", "y [m]", items, (-half_x, half_x),
                        (-half_y, half_y), equal=True, width=PHASE_WIDTH,
                        note="Dashed: the curve. Discs: the phase's end." * (n == 1))  # fmt: skip


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
        items.append(Line(v.t, given, k, "", "thin dashed", f"{name} delivered"))
        items.append(Line(v.t, commanded, k, f"{name} demanded"))
    yield Chart("force", "Force demanded and delivered", "time [s]", "force [N]", items,
                _time(history), note="Means over 1 s. Delivered (thin, dashed): computed "
                "from the pulses and the jet table.")  # fmt: skip


def _valves(scenario: Experiment, history: History) -> Iterator[Chart]:
    rows: list[Item] = []
    names: list[tuple[float, str]] = []
    for k, name, v in _vehicles(history):
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
            loop.append(Line(v.wires[:, 0], 1e3 * v.wires[:, 1], k + len(loop), name))
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
        for k, name, v in _vehicles(history)
        if np.any(v.filtered)
    ]
    yield Chart("filter", "Force change by the safety filter", "time [s]", "force [N]", items,
                _time(history), height=150)  # fmt: skip
