"""A board that is not modelled: real firmware says what its outputs did, and the plant follows.

The report comes after the edge, so the plant must run behind by as much. What flows because of an
edge begins a valve's dead time later, which is the slack. An edge that is reported after the plant
has gone past it is still taken, and counted: the flow then differs from what the firmware did.
"""

import numpy as np

from sim_twin.board import Pulses, nanoseconds
from testbed.core.vehicle import Vehicle

NOT_YET = 10**15  # [ns] a valve that is open has not been closed yet


class ReportedValves:
    """One vehicle's valves, as its firmware drives them; times are of the plant [ns]."""

    def __init__(self, vehicle: Vehicle, pulses: Pulses, rng: np.random.Generator) -> None:
        self._jets = len(vehicle.jets)
        self._dead = nanoseconds(min(vehicle.valve.open_delay_s, vehicle.valve.close_delay_s))
        self._spread = vehicle.tolerance.pulse
        self._rng = rng
        self.pulses = pulses
        self.mask = 0
        self.openings = 0
        self.late = 0  # edges that came after the plant had gone past what they do

    def edge(self, t: int, mask: int, plant_t: float) -> None:
        """From `t` on these valves are open; the plant is at `plant_t` [s]."""
        if t + self._dead < nanoseconds(plant_t):
            self.late += 1
        changed, self.mask = mask ^ self.mask, mask
        for j in range(self._jets):
            if not changed >> j & 1:
                continue
            up, down = self.pulses.up[j], self.pulses.down[j]
            if not mask >> j & 1:
                down[-1] = max(t, int(up[-1]))
                continue
            strength = self.pulses.strength[j]
            for row in (up, down, strength):
                row[:-1] = row[1:].copy()
            up[-1], down[-1] = t, NOT_YET
            strength[-1] = 1.0 + self._spread * self._rng.standard_normal()
            self.openings += 1

    def close_all(self, t: int) -> None:
        """The board is gone."""
        self.pulses.down[self.pulses.down == NOT_YET] = t
        self.mask = 0
