"""Warns about implausible values: a wrong unit, a missing jet, a typing error.

Only `testbed check` prints these. The ranges are wide: they contain every published vehicle and
table that the survey in configs/vehicles/generic_8jet.toml names, with a factor of ten to spare.
"""

import math
from collections.abc import Iterable, Iterator, Mapping
from itertools import chain, pairwise

import numpy as np

from controllers.lqr import LqrParams
from controllers.pd import PdParams
from testbed.config.error import did_you_mean
from testbed.config.experiment import Experiment, VehicleSetup
from testbed.config.hardware import WAYS, strength
from testbed.config.parts import doubtful_parts
from testbed.config.surroundings import doubtful_surroundings
from testbed.core.law import Concern
from testbed.core.se2 import wrap
from testbed.core.table import Tilt
from testbed.core.vehicle import Vehicle
from testbed.flight.allocation import weakest_force
from testbed.metrics.formation import has_formation

BLIND = (PdParams, LqrParams)  # laws that ignore obstacles
UNEQUAL = 0.8  # smallest plausible ratio of force between opposite directions
FAST = 1.0  # largest plausible acceleration [m/s^2]
STEEP = 0.5  # largest plausible share of the jets' acceleration for the steepest slope
LEAST_GYRATION, MOST_GYRATION = 0.1, 3.0  # plausible shares of the radius
OFF_BALANCE = 0.4  # largest plausible distance of the centre of mass, in radii
MOST_DROOP = 0.2  # U. Kentucky's stand has 0.03, SPOT RED's logs say 0.36 to 0.67
SLOW = 0.003  # smallest plausible acceleration [m/s^2]


def doubts_of(experiment: Experiment) -> list[Concern]:
    """Warnings about implausible values."""
    found: list[Concern] = []
    for name, setup in experiment.vehicles.items():
        found += [
            Concern(one, f"{name}: {text}")
            for one, text in _vehicle(setup.model, experiment.table.tilt)
        ]
        found += [
            Concern(one, f"{name}: {text}")
            for one, text in chain(
                doubtful_parts(experiment, setup.model), _flight(experiment, setup)
            )
        ]
    found += doubtful_surroundings(experiment)
    found += [Concern("obstacle-off-table", text) for text in _off_table(experiment)]
    return [*found, *_wires(experiment)]


def _vehicle(vehicle: Vehicle, tilt: Tilt) -> Iterator[tuple[str, str]]:
    weakest, strongest = (f(jet.thrust for jet in vehicle.jets) for f in (min, max))
    air, valve = vehicle.air, vehicle.valve
    for name, what, value, low, high, usual, meant in (
        ("mass", "mass", vehicle.mass, 0.5, 500.0, "4 to 220 kg", "g meant?"),
        ("thrust", "thrust of a jet", strongest if strongest > 20.0 else weakest, 0.005, 20.0,
         "0.1 to 12 N", "mN meant?"),
        ("pressure", "air.set_pressure", air.set_pressure, 2e4, 3e6, "2e5 to 1e6 Pa", "bar meant?"),
        ("pressure", "air.tank_pressure", air.tank_pressure, 1e5, 1e8, "1e6 to 3e7 Pa",
         "bar meant?"),
    ):  # fmt: skip
        unit = {"mass": "kg", "thrust": "N", "pressure": "Pa"}[name]
        if not low <= value <= high:
            yield name, f"{what} is {value:g} {unit}: published vehicles have {usual}; {meant}"
    accel = weakest_force(vehicle) / vehicle.mass
    if not SLOW <= accel <= FAST:
        yield (
            "acceleration",
            f"the jets give it {accel:.2g} m/s^2: published vehicles have 0.02 to 0.2 m/s^2;"
            " thrust in N, mass in kg?",
        )
    gyration = math.sqrt(vehicle.inertia / vehicle.mass) / vehicle.radius
    if not LEAST_GYRATION <= gyration <= MOST_GYRATION:
        yield (
            "inertia",
            f"its radius of gyration is {gyration:.2g} of its radius, {vehicle.radius:g} m: a disc"
            " has 0.71; inertia in kg m^2?",
        )
    aside = math.hypot(*vehicle.com)
    if aside > OFF_BALANCE * vehicle.radius:
        yield (
            "com",
            f"its centre of mass is {aside:g} m from its origin, of a radius of"
            f" {vehicle.radius:g} m: published vehicles have up to 0.01 m; `com` is relative to"
            " the origin of the jets' positions",
        )
    if air.droop > MOST_DROOP:
        yield (
            "droop",
            f"air.droop is {air.droop:.2g}: two open jets give {1.0 / (1.0 + air.droop):.0%} of"
            f" their thrust each. More than {MOST_DROOP:g} is rare. Check that it is the share"
            " that each further open jet takes",
        )
    can = strength(vehicle)
    for one, other in list(pairwise(WAYS))[::2]:
        weak, strong = sorted((one, other), key=lambda way: can[way])
        if can[weak] < UNEQUAL * can[strong]:
            unit = "N" if "turn" not in one else "N m"
            yield (
                "jets-unequal",
                f"{len(vehicle.jets)} jets, {can[weak]:.3g} {unit} {weak} but"
                f" {can[strong]:.3g} {unit} {strong}: is a jet {weak} missing?",
            )
    slope = tilt.steepest
    if slope > STEEP * accel:
        where = ", at the steepest place of its map," if tilt.map else ""
        found = f"the table's slope{where} takes {slope:.2g} of the {accel:.2g} m/s^2 of the jets"
        left = "little is left to steer with"
        if slope >= accel:
            found = (
                f"the table's slope{where} of {slope:.2g} m/s^2 is more than the jets give,"
                f" {accel:.2g}"
            )
            left = "the vehicle slides off"
        yield "slope", f"{found}: {left}"
    if valve.min_on_s < valve.open_delay_s:
        yield (
            "valve",
            f"valve.min_on_s is {1e3 * valve.min_on_s:g} ms, and a valve starts to open only after"
            f" {1e3 * valve.open_delay_s:g} ms (open_delay_s): a valve that is closed before that"
            " may give nothing",
        )


def _flight(experiment: Experiment, setup: VehicleSetup) -> Iterator[tuple[str, str]]:
    if setup.path is not None:
        return
    needed = max(quickest_s(experiment, setup))
    if needed > experiment.duration_s:
        yield (
            "too-short",
            f"at least {needed:.0f} s from start to goal, the run ends after"
            f" {experiment.duration_s:g} s",
        )
    gas, filled = gas_to_goal(experiment, setup), setup.model.air.gas
    if gas > filled and not has_formation(experiment.controller):
        yield (
            "gas",
            f"the way to the goal takes about {1e3 * gas:.2g} g of gas, the tank has"
            f" {1e3 * filled:.3g} g; is air.exhaust_speed in m/s?",
        )
    elif (gas := gas_for(setup.model, experiment.table.tilt, experiment.duration_s)) > filled:
        lasts = experiment.duration_s * filled / gas
        yield (
            "gas",
            f"floating and holding against the slope takes at least {1e3 * gas:.3g} g of gas in"
            f" {experiment.duration_s:g} s, the tank has {1e3 * filled:.3g} g: it lasts for"
            f" {lasts:.0f} s at most",
        )
    if not isinstance(experiment.controller, BLIND):
        return
    for name, obstacle in experiment.obstacles.items():
        gap = _gap(setup.start[:2], setup.goal[:2], obstacle.position)
        if gap < obstacle.radius and obstacle.velocity == (0.0, 0.0):
            yield (
                "way-blocked",
                f"the straight way from start to goal passes {gap:.3f} m from {name}, whose danger"
                f" radius is {obstacle.radius:g} m, and this law does not know obstacles",
            )


def quickest_s(experiment: Experiment, setup: VehicleSetup) -> tuple[float, float]:
    """Shortest times [s]: to the place of the goal with full thrust both ways, and of the turn.

    The turn is a quintic polynomial, as guidance plans it.
    """
    params = experiment.guidance
    accel = params.force_share * weakest_force(setup.model) / setup.model.mass
    move = 2.0 * math.sqrt(math.dist(setup.start[:2], setup.goal[:2]) / accel)
    angle = abs(wrap(setup.goal[2] - setup.start[2]))
    return move, math.sqrt(10.0 / math.sqrt(3.0) * angle / params.heading_accel)


def gas_to_goal(experiment: Experiment, setup: VehicleSetup) -> float:
    """Gas for speeding up, slowing down and floating on the way to the goal [kg]."""
    model, time = setup.model, max(quickest_s(experiment, setup))
    way = math.dist(setup.start[:2], setup.goal[:2])
    speed = min(experiment.flight.barrier.max_speed, 2.0 * way / time if time else 0.0)
    return 2.0 * model.mass * speed / model.air.exhaust_speed + time * model.air.bearing_flow


def gas_for(vehicle: Vehicle, tilt: Tilt, time: float) -> float:
    """Lower bound of the gas for floating and holding still on the table's mean slope [kg]."""
    nodes = np.array([node for row in tilt.map for node in row] or [(0.0, 0.0)])
    slope = float(np.hypot(*(nodes.mean(axis=0) + tilt.uniform)))
    air, force = vehicle.air, min(vehicle.mass * slope, weakest_force(vehicle))
    return time * (force / air.exhaust_speed + air.bearing_flow)


def _gap(start: tuple[float, ...], end: tuple[float, ...], point: tuple[float, ...]) -> float:
    """Distance of a point from the segment between two others [m]."""
    a, b, p = np.array(start), np.array(end), np.array(point)
    along = b - a
    share = np.clip((p - a) @ along / max(along @ along, 1e-12), 0.0, 1.0)
    return float(np.hypot(*(a + share * along - p)))


def _off_table(experiment: Experiment) -> Iterator[str]:
    """Obstacles that stay where no vehicle can come near them."""
    size = experiment.table.size
    for name, obstacle in experiment.obstacles.items():
        x, y = obstacle.position
        gap = math.hypot(max(abs(x) - 0.5 * size[0], 0.0), max(abs(y) - 0.5 * size[1], 0.0))
        if gap >= obstacle.radius and obstacle.velocity == (0.0, 0.0):
            yield (
                f"{name} is {gap:.3g} m off the table of {size[0]:g} m x {size[1]:g} m, and its"
                f" danger radius is {obstacle.radius:g} m: no vehicle comes near it"
            )


def _wires(experiment: Experiment) -> Iterator[Concern]:
    """Warn if [lab] lists some vehicles but not all."""
    lab, names = experiment.table.lab, list(experiment.vehicles)
    for name in _unnamed(names, lab.mocap.bodies):
        hint = _misspelt(name, names, lab.mocap.bodies)
        text = f"[lab.mocap] bodies has no entry for {name}{hint}: a body called {name} is expected"
        yield Concern("body-unnamed", text)
    for name in _unnamed(names, lab.serial.ports):
        hint = _misspelt(name, names, lab.serial.ports)
        yield Concern("port-unnamed", f"[lab.serial] ports has no entry for {name}{hint}")


def _unnamed(names: Iterable[str], entries: Mapping[str, str]) -> list[str]:
    return [name for name in names if entries and name not in entries]


def _misspelt(name: str, names: list[str], entries: Mapping[str, str]) -> str:
    return did_you_mean(name, [one for one in entries if one not in names])
