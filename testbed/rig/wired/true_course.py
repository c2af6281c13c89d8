"""The true course of a flight on the bench, recorded at each exposure of the cameras."""

from collections.abc import Mapping

import numpy as np

from sim_twin.fault_injection import FaultInjector
from sim_twin.plant import Plant
from sim_twin.reported import ReportedValves
from testbed.metrics.afterwards import MINUTE, STEP


class TrueCourse:
    """States and consumption of all vehicles so far.

    Args:
        plant: the plant that is recorded.
        valves: of each vehicle, in the plant's order.
    """

    def __init__(self, plant: Plant, valves: Mapping[str, ReportedValves]) -> None:
        self._plant, self._valves = plant, valves
        self.t: list[float] = []  # [s]
        self.states: list[list[list[float]]] = []  # (n, v, 6)
        # impulse [N s], gas [kg] and openings of each vehicle; (n, v, 3)
        self.spent: list[list[tuple[float, float, int]]] = []

    def note(self, t: float) -> None:
        """Record the plant, which is at `t` [s]."""
        self.t.append(t)
        self.states.append(self._plant.x.tolist())
        openings = [valves.openings for valves in self._valves.values()]
        impulse, used = self._plant.impulse.tolist(), self._plant.used.tolist()
        self.spent.append(list(zip(impulse, used, openings, strict=True)))

    def minute_after(self, injector: FaultInjector) -> tuple[list[float], list[list[list[float]]]]:
        """Simulate one minute with valves and air as last reported by the boards.

        Returns:
            Times [s], and states (n, v, 6), until every vehicle stands.
        """
        plant, t, states = self._plant, list[float](), list[list[list[float]]]()
        end = plant.t + MINUTE
        while plant.t < end and not (t and plant.stands):
            until = min(plant.t + 1.0, end)
            injector.before(until)
            marks = np.arange(plant.t, until, STEP)
            states += plant.advance(until, marks).tolist()
            t += marks.tolist()
        return t, states
