"""Errors of vehicles over time, for figures and the dashboard.

With most laws each vehicle has a goal, which may move along a path. With a formation law the error
is that of the graph's edge lengths, or the distance to a phase's curve. `testbed.metrics.formation`
computes the final values.
"""

from collections.abc import Mapping
from typing import Any, NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from controllers.bifurcating import BifurcatingParams
from controllers.bifurcating_design import AXES, HALF_LENGTH, OFFSET, RADIUS, Shape, distance_to
from controllers.graph import LEADER, formation, formation_kind
from testbed.config.experiment import Experiment, VehicleSetup
from testbed.metrics.formation import CURVE_M, EDGE_M
from testbed.metrics.run_metrics import SETTLED_M

Array = NDArray[np.float64]


class FormationEdge(NamedTuple):
    """Two vehicles, or a vehicle and the leader, and their desired distance."""

    a: str
    b: str  # LEADER: the moving goal
    length: float  # [m]


def goal_at(setup: VehicleSetup, t: Array) -> Array:
    """Goal position of a vehicle, shape (len(t), 2) [m]."""
    start = np.tile(np.array(setup.goal[:2]), (len(t), 1))
    if setup.path is None or len(t) == 0:
        return start
    return start + np.array([setup.path.at(one).p for one in t.tolist()])


def curves(shape: Shape) -> list[tuple[Array, Array]]:
    """The curve of `shape` on the table, x and y relative to the formation's centre [m]."""
    angle, along = np.linspace(0.0, 2.0 * np.pi, 181), np.array([-HALF_LENGTH, HALF_LENGTH])
    match shape:
        case "circle":
            return [(RADIUS * np.cos(angle), RADIUS * np.sin(angle))]
        case "line":
            return [(along, 0.0 * along)]
        case "double_line":
            return [(along, 0.0 * along + OFFSET), (along, 0.0 * along - OFFSET)]
        case "ellipse" | "flat":
            a, b, r = AXES[shape]
            return [(a * r * np.cos(angle), b * r * np.sin(angle))]


class GoalError:
    """The goals, edges or curves of a scenario, and errors to them."""

    def __init__(self, scenario: Experiment) -> None:
        self._scenario, self._law = scenario, cast(Any, scenario.controller)
        kind = formation_kind(self._law)
        self.forms = kind is not None  # vehicles have no individual goals
        self.led = kind == "led graph"
        self.edges: list[FormationEdge] = self._edges() if kind in ("graph", "led graph") else []
        self.settled_m = SETTLED_M
        self.title = "Distance to the goal"
        if self.edges:
            self.title, self.settled_m = "Formation edges: length error", EDGE_M
        elif self.forms:
            self.title, self.settled_m = "Distance to the formation's curve", CURVE_M

    def _edges(self) -> list[FormationEdge]:
        names = list(self._scenario.vehicles)
        shape = formation(self._law.formation, names, self.led)
        members = [*names, LEADER]
        return [
            FormationEdge(
                members[i], members[j], float(shape.desired[i, j]) / self._law.scale.length
            )
            for i, j in np.argwhere(np.triu(shape.first) > 0.0)
        ]

    def leader_at(self, t: Array) -> Array:
        """The goal of the first vehicle that has a path, or the first's, shape (len(t), 2) [m]."""
        setups = list(self._scenario.vehicles.values())
        return goal_at(next((s for s in setups if s.path is not None), setups[0]), t)

    def parts(self, t: Array, places: Mapping[str, Array]) -> dict[str, Array]:
        """Error by vehicle, or by edge [m]; `places` are of shape (len(t), 2)."""
        if self.edges:
            members = {**places, LEADER: self.leader_at(t)} if self.led else places
            return {
                f"{a}, {b}": np.abs(np.hypot(*(members[a] - members[b]).T) - length)
                for a, b, length in self.edges
                if a in members and b in members
            }
        if formation_kind(self._law) == "curves":
            return {name: self._to_curve(self._law, t, place) for name, place in places.items()}
        vehicles = self._scenario.vehicles
        return {
            name: np.hypot(*(place - goal_at(vehicles[name], t)).T)
            for name, place in places.items()
        }

    def _to_curve(self, law: BifurcatingParams, t: Array, place: Array) -> Array:
        """Distance to the phase's curve [m]; NaN in phases without a curve."""
        off = np.full(len(t), np.nan)
        centre = np.zeros(2) if law.centre is None else np.array(law.centre)
        ends = [*(phase.at for phase in law.phases[1:]), np.inf]
        for phase, end in zip(law.phases, ends, strict=True):
            inside = (t >= phase.at) & (t < end)
            if phase.shape is not None and inside.any():
                off[inside] = distance_to(phase.shape, place[inside] - centre)
        return off

    def by_vehicle(self, t: Array, places: Mapping[str, Array]) -> dict[str, Array]:
        """Error by vehicle; with edges, the largest error of its edges [m]."""
        parts = self.parts(t, places)
        if not self.edges:
            return parts
        mine = {
            name: [
                parts[f"{a}, {b}"]
                for a, b, _ in self.edges
                if name in (a, b) and f"{a}, {b}" in parts
            ]
            for name in places
        }
        return {name: np.max(offs, axis=0) for name, offs in mine.items() if offs}
