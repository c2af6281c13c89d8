"""Figures of the table from above: the whole flight, a small motion enlarged, each phase."""

from collections.abc import Iterator

import numpy as np

from controllers.graph import LEADER
from testbed.config.experiment import Experiment
from testbed.logs.history import History, VehicleHistory
from testbed.report.goal_error import GoalError, curves, goal_at
from testbed.report.item import Chart, Disc, Item, Line, Point

SMALL = 0.25  # of the table: motion in less than this is drawn enlarged
PHASE_WIDTH = 400  # of a figure of one phase; letters are larger in it
GHOSTS = 9  # instants at which the vehicles are drawn along their tracks


def enumerated(history: History) -> Iterator[tuple[int, str, VehicleHistory]]:
    """Number, name and history of each vehicle."""
    for k, (name, vehicle) in enumerate(history.vehicles.items()):
        yield k, name, vehicle


def trajectory(scenario: Experiment, history: History) -> Iterator[Chart]:
    """The paths of all vehicles, with starts, goals and obstacles."""
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
    for k, name, vehicle in enumerated(history):
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


def near(scenario: Experiment, history: History) -> Iterator[Chart]:
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


def phases(scenario: Experiment, history: History) -> Iterator[Chart]:
    """One small table per phase of a law whose formation changes, with the phase's curve."""
    plan = getattr(scenario.controller, "phases", ())
    if len(plan) < 2:
        return
    half_x, half_y = scenario.table.size[0] / 2, scenario.table.size[1] / 2
    centre = getattr(scenario.controller, "centre", None) or (0.0, 0.0)
    ends = [*(phase.at for phase in plan[1:]), history.end]
    for n, (phase, end) in enumerate(zip(plan, ends, strict=True), 1):
        items: list[Item] = []
        for x, y in curves(phase.shape) if phase.shape else ():
            items.append(Line(centre[0] + x, centre[1] + y, 0, "", "way dashed"))
        for k, name, _ in enumerated(history):
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
