"""The true vehicles: the vehicle file's values, varied within its tolerances by the seed."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from msgspec import structs
from numpy.typing import NDArray

from sim_twin.randomness import stream
from testbed.core.table import Spread
from testbed.core.vehicle import Tolerance, Vehicle

Array = NDArray[np.float64]

AS_IN_THE_FILES = Spread()


class PlantParameters(NamedTuple):
    """True parameters of a fleet of v vehicles with up to j jets, for compiled code.

    Torques and positions are about the body's origin, in B; unused columns have no thrust.
    """

    mass: Array  # (v,) with a full tank [kg]
    inertia: Array  # (v,) about the centre of mass, full tank [kg m^2]
    com: Array  # (v, 2) full tank [m]
    radius: Array  # (v,) [m]
    drag: Array  # (v,) [N s/m]
    spin_drag: Array  # (v,) [N m s/rad]
    grip: Array  # (v, 2) dry friction without bearing air: [m/s^2], [rad/s^2]; 0: it floats
    effect: Array  # (v, 3, j) wrench of a fully open jet at set pressure
    thrust: Array  # (v, j) its magnitude [N]
    gas: Array  # (v,) in the full tank [kg]
    tank: Array  # (v, 2) [m]
    exhaust_speed: Array  # (v,) [m/s]
    droop: Array  # (v,)
    bearing_flow: Array  # (v,) [kg/s]
    tank_pressure: Array  # (v,) full [Pa]
    set_pressure: Array  # (v,) [Pa]
    dropout: Array  # (v,) [Pa]
    timing: Array  # (v, 4) open delay, close delay, open ramp, close ramp [s]
    late: Array  # (v, j) further delay of each valve [s]
    hose: Array  # (v, 3) force in W [N] and torque [N m] of a hose


def sample_plant(
    vehicles: Mapping[str, Vehicle], seed: int, lab: Spread = AS_IN_THE_FILES
) -> PlantParameters:
    """Sample the true parameters of all vehicles."""
    jets = max(len(v.jets) for v in vehicles.values())
    drawn = [
        _sample_one(vehicle, stream(seed, name, "metal"), jets)
        for name, vehicle in vehicles.items()
    ]
    plant = PlantParameters(*(np.array(column) for column in zip(*drawn, strict=True)))
    for k, name in enumerate(vehicles):
        rng = stream(seed, name, "lab")
        stronger = max(0.0, 1.0 + lab.thrust * rng.standard_normal())
        plant.effect[k] *= stronger
        plant.thrust[k] *= stronger
        plant.hose[k] = rng.standard_normal(3) * (lab.hose, lab.hose, lab.hose_torque)
        plant.late[k] = lab.delay_s * rng.standard_normal(jets)
    return plant


def nominal_plant(vehicle: Vehicle) -> PlantParameters:
    """The parameters of one vehicle as in its file, without tolerances."""
    exact = Tolerance(0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    return sample_plant({"": structs.replace(vehicle, tolerance=exact)}, 0)


def _sample_one(vehicle: Vehicle, rng: np.random.Generator, jets: int) -> PlantParameters:
    spread, air, valve = vehicle.tolerance, vehicle.air, vehicle.valve
    effect, thrust = np.zeros((3, jets)), np.zeros(jets)
    for j, jet in enumerate(vehicle.jets):
        force = jet.thrust * max(0.0, 1.0 + spread.thrust * rng.standard_normal())
        angle = np.radians(spread.direction_deg) * rng.standard_normal()
        push = np.array([
            np.cos(angle) * jet.push[0] - np.sin(angle) * jet.push[1],
            np.sin(angle) * jet.push[0] + np.cos(angle) * jet.push[1],
        ])  # fmt: skip
        fx, fy = force * push
        effect[:, j] = fx, fy, jet.position[0] * fy - jet.position[1] * fx
        thrust[j] = force
    mass, inertia = (1.0 + np.array([spread.mass, spread.inertia]) * rng.standard_normal(2)).clip(
        0.5
    )
    return PlantParameters(
        mass=vehicle.mass * mass,
        inertia=vehicle.inertia * inertia,
        com=np.array(vehicle.com) + spread.com * rng.standard_normal(2),
        radius=np.array(vehicle.radius),
        drag=np.array(vehicle.drag),
        spin_drag=np.array(vehicle.spin_drag),
        grip=np.zeros(2),
        effect=effect,
        thrust=thrust,
        gas=np.array(air.gas),
        tank=np.array(air.tank_position, dtype=float),
        exhaust_speed=np.array(air.exhaust_speed),
        droop=np.array(air.droop),
        bearing_flow=np.array(air.bearing_flow),
        tank_pressure=np.array(air.tank_pressure),
        set_pressure=np.array(air.set_pressure),
        dropout=np.array(air.dropout),
        timing=np.array(
            [valve.open_delay_s, valve.close_delay_s, valve.open_ramp_s, valve.close_ramp_s]
        ),
        late=np.zeros(jets),
        hose=np.zeros(3),
    )
