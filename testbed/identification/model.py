"""The numbers of a vehicle that a motion log can tell, as a vector with priors.

Accelerations tell forces over mass. So with valve commands the mass is the file's and the thrust is
estimated; with commanded wrenches the mass is estimated.
"""

from collections.abc import Sequence
from copy import copy
from typing import NamedTuple

import numpy as np
from msgspec import structs
from numpy.typing import NDArray

from sim_twin.ground import Ground, lay
from sim_twin.plant_parameters import PlantParameters, nominal_plant
from sim_twin.schedule import Schedule
from testbed.core.table import Table
from testbed.core.vehicle import Vehicle
from testbed.identification.prediction import LEVEL, Inputs, schedule_of

Array = NDArray[np.float64]
LEAST_THRUST = 1e-3  # [N] of a dead jet in a vehicle file, which has no zero
TINY = 1e-4  # smallest relative thrust, mass and inertia in a fit


class Parameter(NamedTuple):
    """One number: prior value, prior standard deviation, step of a difference, group."""

    name: str
    unit: str
    value: float
    sigma: float
    step: float
    group: str  # chosen or left out together
    least: float = -np.inf


class VehicleModel:
    """A vehicle file and the parameters that are varied.

    `thrust` scales all jets, `thrust_j` the jet j on top of it. `delay` is the opening and closing
    delay together, `hold` how much later a valve closes than it opens. `lever_j`, which only a test
    of the vehicle asks for, is how much longer the lever of jet j is than in the file.
    """

    def __init__(
        self, vehicle: Vehicle, *, valves: bool, table: Table | None = None, levers: bool = False
    ) -> None:
        self.vehicle, self.valves, self.levers = vehicle, valves, levers
        self.ground = LEVEL if table is None else lay(table)
        v, jets = vehicle, len(vehicle.jets) if valves else 0
        spread = max(0.15, 2.0 * v.tolerance.thrust)
        delay = v.valve.open_delay_s
        turning, slow = max(0.2, 2.0 * v.tolerance.inertia), max(v.drag, 0.05 * v.mass)
        own = [
            Parameter(f"thrust_{j + 1}", "", 1.0, spread, 0.01, "jets", TINY) for j in range(jets)
        ]
        self.parameters = [
            Parameter("thrust", "", 1.0, 0.3, 0.01, "thrust", TINY)
            if valves
            else Parameter("mass", "", 1.0, 0.5, 0.01, "thrust", TINY),
            *own,
            Parameter("inertia", "", 1.0, turning, 0.01, "inertia", TINY),
            Parameter("delay", "s", delay, 0.15, 0.002, "delay"),
            Parameter("com_x", "m", v.com[0], 0.01, 0.001, "com"),
            Parameter("com_y", "m", v.com[1], 0.01, 0.001, "com"),
            Parameter("slope_x", "m/s^2", 0.0, 0.01, 0.001, "slope"),
            Parameter("slope_y", "m/s^2", 0.0, 0.01, 0.001, "slope"),
            Parameter("drag", "N s/m", v.drag, slow, 0.005 * v.mass, "drag", 0.0),
            Parameter("spin_drag", "N m s/rad", v.spin_drag, max(v.spin_drag, 0.1 * v.inertia),
                      0.005 * v.inertia, "spin_drag", 0.0),
        ]  # fmt: skip
        if valves:
            gap = v.valve.close_delay_s - delay
            self.parameters += [
                Parameter("droop", "", v.air.droop, 0.3, 0.01, "droop", 0.0),
                Parameter("hold", "s", gap, 0.02, 0.001, "hold"),
            ]
        if levers:
            names = [f"lever_{j + 1}" for j in range(jets)]
            self.parameters += [Parameter(n, "m", 0.0, 0.03, 0.002, n) for n in names]
        self.names = [p.name for p in self.parameters]
        self.prior = np.array([p.value for p in self.parameters])
        self.sigma = np.array([p.sigma for p in self.parameters])
        self.step = np.array([p.step for p in self.parameters])
        self.least = np.array([p.least for p in self.parameters])
        self.plant = nominal_plant(vehicle)
        self.held: list[int] = []  # positions that no fit moves, see `holding`

    def holding(self, positions: Sequence[int]) -> "VehicleModel":
        """The same model, but no fit moves these numbers."""
        other = copy(self)
        other.held = list(positions)
        return other

    @property
    def groups(self) -> list[str]:
        """Groups of parameters, in order."""
        return list(dict.fromkeys(one.group for one in self.parameters))

    def index(self, name: str) -> int:
        """Position of a parameter."""
        return self.names.index(name)

    def of_groups(self, groups: Sequence[str]) -> NDArray[np.int64]:
        """Positions of the parameters of some groups, without those that are held."""
        found = [k for k, p in enumerate(self.parameters) if p.group in groups]
        return np.array([k for k in found if k not in self.held], dtype=np.int64)

    def thrust(self, p: Array) -> Array:
        """Relative thrust of each jet."""
        if not self.valves:
            return np.ones(len(self.vehicle.jets))
        return p[0] * p[1 : 1 + len(self.vehicle.jets)]

    def build(
        self, p: Array, inputs: Inputs, effect: Array | None = None
    ) -> tuple[Schedule, PlantParameters, Ground]:
        """Arguments of `sim_twin.prediction.shoot`; `effect` replaces the jets' wrenches."""
        at = dict(zip(self.names, p, strict=True))
        m = self.plant
        scale = self.thrust(p)
        effect = m.effect * scale if effect is None else effect[None]
        if self.levers:
            effect[0, 2] += p[-len(scale) :] * m.thrust[0] * scale
        timing = m.timing.copy()
        timing[0, 0] = at["delay"]
        timing[0, 1] = at["delay"] + at.get("hold", 0.0)
        plant = m._replace(
            mass=m.mass * at.get("mass", 1.0),
            inertia=m.inertia * at["inertia"],
            com=np.array([[at["com_x"], at["com_y"]]]),
            drag=np.array([at["drag"]]),
            spin_drag=np.array([at["spin_drag"]]),
            effect=effect,
            thrust=m.thrust * scale,
            droop=np.array([at.get("droop", 0.0)]),
            timing=timing,
        )
        slope = self.ground.uniform + np.array([at["slope_x"], at["slope_y"]])
        ground = self.ground._replace(uniform=slope)
        return (schedule_of(inputs, plant, self.vehicle.command_delay_s), plant, ground)

    def fitted(self, p: Array) -> Vehicle:
        """The vehicle with these numbers; the slope belongs to the table."""
        at = dict(zip(self.names, map(float, p), strict=True))
        v = self.vehicle
        jets = [
            structs.replace(jet, thrust=max(LEAST_THRUST, jet.thrust * float(scale)))
            for jet, scale in zip(v.jets, self.thrust(p), strict=True)
        ]
        shift = max(0.0, at["delay"])
        hold = at.get("hold", v.valve.close_delay_s - v.valve.open_delay_s)
        close = max(0.0, shift + hold)
        closing = 1e-6 + close + v.valve.close_ramp_s - shift  # a file is rounded
        valve = structs.replace(
            v.valve, open_delay_s=shift, close_delay_s=close,
            min_off_s=max(v.valve.min_off_s, closing),
        )  # fmt: skip
        return structs.replace(
            v,
            mass=v.mass * at.get("mass", 1.0),
            inertia=v.inertia * at["inertia"],
            com=(at["com_x"], at["com_y"]),
            drag=at["drag"],
            spin_drag=at["spin_drag"],
            jets=jets,
            valve=valve,
            air=structs.replace(v.air, droop=at.get("droop", v.air.droop)),
        )
