"""Valves driven by real firmware, which reports its output edges to the plant.

The report arrives after the edge, so the plant must lag behind. Flow starts a valve's dead time
after the edge, which is the allowed lag. An edge reported after the plant has passed it is counted,
and its pulse flows later, for as long as the firmware's output was on. Otherwise a busy computer
would look like a weak jet.
"""

import numpy as np

from sim_twin.board import Pulses, nanoseconds
from testbed.core.vehicle import Vehicle

NOT_YET = 10**15  # [ns] closing time of a valve that is open


class ReportedValves:
    """One vehicle's valves, driven by its firmware; times are plant times [ns]."""

    def __init__(self, vehicle: Vehicle, pulses: Pulses, rng: np.random.Generator) -> None:
        self._jets = len(vehicle.jets)
        self._dead = nanoseconds(min(vehicle.valve.open_delay_s, vehicle.valve.close_delay_s))
        self._spread = vehicle.tolerance.pulse
        self._rng = rng
        self.pulses = pulses
        self.mask = 0
        self.openings = 0
        self._later = [0] * self._jets  # how much later the newest pulse flows [ns]
        self._owed = [0] * self._jets  # how much too long the one before has flowed [ns]
        self.late = 0  # edges reported after the plant had passed their effect

    def edge(self, t: int, mask: int, plant_t: float) -> None:
        """Set the open valves to `mask` from `t` on; the plant is at `plant_t` [s]."""
        soonest = nanoseconds(plant_t) - self._dead
        if t < soonest:
            self.late += 1
        changed, self.mask = mask ^ self.mask, mask
        for j in range(self._jets):
            if not changed >> j & 1:
                continue
            up, down = self.pulses.up[j], self.pulses.down[j]
            if not mask >> j & 1:
                wanted = t + self._later[j]
                down[-1] = max(wanted, soonest, int(up[-1]))
                self._owed[j] = int(down[-1]) - wanted
                continue
            strength = self.pulses.strength[j]
            for row in (up, down, strength):
                row[:-1] = row[1:].copy()
            self._later[j] = max(0, soonest - t)
            up[-1], down[-1] = t + self._later[j] + self._owed[j], NOT_YET
            strength[-1] = 1.0 + self._spread * self._rng.standard_normal()
            self.openings += 1

    def close_all(self, t: int) -> None:
        """Close all valves at `t`, because the board is gone."""
        self.pulses.down[self.pulses.down == NOT_YET] = t
        self.mask = 0
