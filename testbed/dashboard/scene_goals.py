"""The part of the dashboard's scene that shows moving goals and position errors."""

from collections.abc import Mapping

import numpy as np

from testbed.config.experiment import Experiment
from testbed.core.path import heading_at
from testbed.core.types import Tick
from testbed.dashboard.columns import ColumnBuffer
from testbed.dashboard.static_scene import plain
from testbed.report.goal_error import GoalError, goal_at


class AimScene:
    """Draws moving goals and the errors to what the experiment asks for."""

    def __init__(self, scenario: Experiment, columns: ColumnBuffer) -> None:
        self._scenario, self._columns = scenario, columns
        self._goal_error = GoalError(scenario)

    def draw(self, newest: Mapping[str, Tick], t: float) -> None:
        """Draw the frame at `t`, from the newest tick of each vehicle."""
        states = {n: s for n, tick in newest.items() if (s := tick.outputs.state) is not None}
        if states:
            at = np.array([max(state.t for state in states.values())])
            places = {n: np.array([[s.pose.x, s.pose.y]]) for n, s in states.items()}
            for name, off in self._goal_error.by_vehicle(at, places).items():
                self._columns.add("scalar", f"plot/error/{name}", t, 1e3 * float(off[0]))
        now = np.array([t])
        if self._goal_error.led:
            x, y = self._goal_error.leader_at(now)[0].tolist()
            self._columns.add("transform", "world/goal/leader", t, (x, y, 0.0))
        for name, setup in self._scenario.vehicles.items():
            if setup.path is not None and not self._goal_error.forms:
                x, y = goal_at(setup, now)[0].tolist()
                place = (x, y, heading_at(setup.path, setup.goal[2], t))
                self._columns.add("transform", f"world/goal/{plain(name)}", t, place)

    def matters(self, a: str, b: str) -> bool:
        """Whether two vehicles must stay in range: formation edges, or all without a formation."""
        edges = self._goal_error.edges
        return not edges or any({a, b} == {e.a, e.b} for e in edges)
