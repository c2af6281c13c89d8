"""The part of the dashboard's picture that shows what is asked for: goals that move, and errors."""

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from testbed.dashboard.static_scene import WHITE, goal, hue
from testbed.logs.feed import SeenTick
from testbed.report.goal_error import Wanted, goal_at
from testbed.report.scenario import Scenario

LEADER_M = 0.12  # radius of a leader as drawn: nobody is there

Array = NDArray[np.float64]


class AimScene:
    """What has been drawn of it so far."""

    def __init__(self, scenario: Scenario, recording: rr.RecordingStream) -> None:
        self._scenario, self._rec = scenario, recording
        self._wanted = Wanted(scenario)
        self._known: dict[str, Array] = {}  # t, x, y of the newest ticks, and of the one before

    def draw(self, ticks: dict[str, list[SeenTick]], now: float) -> None:
        """Take in what has come."""
        for name, flown in ticks.items():
            known = [(s.t, s.pose.x, s.pose.y) for o in flown if (s := o.outputs.state) is not None]
            if known and name in self._scenario.vehicles:
                before = self._known.get(name, np.array(known[:1]))
                self._known[name] = np.vstack([before[-1:], known])
        for name in ticks:
            if name in self._known:
                self._error(name)
        self._goals(now)

    def matters(self, a: str, b: str) -> bool:
        """Whether two have to stay within the range: the edges of a formation, if there is one."""
        edges = self._wanted.edges
        return not edges or any({a, b} == {e.a, e.b} for e in edges)

    def _error(self, name: str) -> None:
        """How far one is from what is asked of him, with the others where they were then."""
        t = self._known[name][1:, 0]
        places = {
            other: np.stack([np.interp(t, at[:, 0], at[:, k]) for k in (1, 2)], axis=1)
            for other, at in self._known.items()
        }
        off = self._wanted.by_vehicle(t, places).get(name)
        if off is not None:
            self._rec.send_columns(
                f"plot/error/{name}",
                [rr.TimeColumn("t", duration=t.tolist())],
                rr.Scalars.columns(scalars=(1e3 * off).tolist()),
            )

    def _goals(self, now: float) -> None:
        """Those that move, and a formation's leader."""
        t = np.array([now])
        self._rec.set_time("t", duration=now)
        if self._wanted.led:
            x, y = self._wanted.leader_at(t)[0].tolist()
            goal(self._rec, "leader", (x, y, 0.0), LEADER_M, WHITE)
        for k, (name, setup) in enumerate(self._scenario.vehicles.items()):
            if setup.path is not None and not self._wanted.forms:
                x, y = goal_at(setup, t)[0].tolist()
                goal(self._rec, name, (x, y, setup.goal[2]), setup.model.radius, hue(k))
