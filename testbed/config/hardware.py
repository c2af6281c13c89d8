"""Validates a vehicle: its jets, body, air and gauges."""

import math
from collections.abc import Iterator, Sequence
from itertools import chain

import numpy as np

from testbed.config.error import Violation, show
from testbed.config.experiment import Experiment
from testbed.core.jets import effect_matrix
from testbed.core.vehicle import Jet, Point, Vehicle

MOST_JETS = 32
DENSEST = 0.01  # smallest ratio of radius of gyration to radius
QUICKEST_STOP, QUICKEST_SPIN_STOP = 0.5, 0.1  # [s] time constants of drag; else it does not float
MOST_SKEW = 20.0  # of a nozzle [deg]
HIGHEST_V = 60.0  # highest setting of the valve board
NEAR = 1e-6  # tolerance of a wrench
WEAK = 1e-3  # pushes and levers below this share of thrust and radius count as zero


def bad_hardware(experiment: Experiment) -> Iterator[Violation]:
    """Errors in the vehicles."""
    for name, setup in experiment.vehicles.items():
        for key, *texts in vehicle_violations(setup.model):
            yield Violation(("vehicles", name, "model", *key), *texts)


def vehicle_violations(model: Vehicle) -> Iterator[Violation]:
    """Errors in one vehicle; keys are those of its file."""
    yield from chain(_jets(model), _body(model), _air(model), _gauges(model), _spread(model))


def _jets(vehicle: Vehicle) -> Iterator[Violation]:
    jets = vehicle.jets
    for i, jet in enumerate(jets):
        if abs(math.hypot(*jet.push) - 1.0) > 1e-3:  # [0.866, 0.5] is meant as a unit vector
            yield Violation(("jets", i, "push"), "a vector of length 1", show(list(jet.push)))
        yield from _within(("jets", i, "position"), jet.position, vehicle.radius)
    if len(jets) > MOST_JETS:
        yield Violation(("jets",), f"at most {MOST_JETS} jets", f"{len(jets)}")
    elif not push_everywhere(jets, vehicle.com, vehicle.radius):
        expected = "jets that push the body every way and turn it both ways"
        ways = "; none ".join(missing_ways(vehicle))
        found = f"{len(jets)}: none {ways or 'of them strongly'}"
        middle = float(np.median([jet.thrust for jet in jets])) if jets else 0.0
        far = [k for k, jet in enumerate(jets, 1) if jet.thrust > FAR * middle]
        if far:
            found += f"; jet {far[0]} has {jets[far[0] - 1].thrust:g} N: mN meant?"
        yield Violation(("jets",), expected, found)


def _within(key: tuple[str | int, ...], point: Point, radius: float) -> Iterator[Violation]:
    if math.hypot(*point) > radius:
        expected = f"a point of the vehicle, at most {radius:g} m from its origin"
        yield Violation(key, expected, show(list(point)))


FAR = 100.0  # times the usual thrust: one jet is in another unit
WAYS = ("towards +x", "towards -x", "towards +y", "towards -y", "turning left", "turning right")


def strength(vehicle: Vehicle) -> dict[str, float]:
    """Largest force [N] and torque [N m] of all helpful jets together, in each direction.

    Directions are those of the body.
    """
    effect = effect_matrix(vehicle.jets, about=vehicle.com)
    both = [(effect[k].clip(min=0.0).sum(), -effect[k].clip(max=0.0).sum()) for k in range(3)]
    return dict(zip(WAYS, map(float, chain.from_iterable(both)), strict=True))


def missing_ways(vehicle: Vehicle) -> list[str]:
    """Directions in which no combination of jets gives a pure force or torque."""
    from scipy.optimize import nnls  # takes a third of a second to import, for a refusal only

    thrust = max((jet.thrust for jet in vehicle.jets), default=1.0)
    scale = thrust * np.array([1.0, 1.0, vehicle.radius])
    effect = effect_matrix(vehicle.jets, about=vehicle.com) / scale[:, None]
    units = [sign * np.eye(3)[axis] for axis in range(3) for sign in (1.0, -1.0)]
    if not vehicle.jets:
        return list(WAYS)
    return [way for way, unit in zip(WAYS, units, strict=True) if nnls(effect, unit)[1] > NEAR]


def push_everywhere(jets: Sequence[Jet], com: Point, radius: float) -> bool:
    """Whether the jets, which only push, can give every wrench: no half-space contains them all.

    Any such half-space can be rotated until two jets lie in its boundary, so only those are tested.
    """
    thrust = max((jet.thrust for jet in jets), default=1.0)
    effect = effect_matrix(jets, about=com).T / (thrust * np.array([1.0, 1.0, radius]))
    if len(jets) < 4 or np.linalg.matrix_rank(effect, tol=WEAK) < 3:
        return False
    first, second = np.triu_indices(len(jets), 1)
    normals = np.cross(effect[first], effect[second])
    length = np.linalg.norm(normals, axis=1)
    reach = (normals[length > WEAK**2] / length[length > WEAK**2, None]) @ effect.T
    return bool(np.all(reach.max(axis=1) > WEAK) and np.all(reach.min(axis=1) < -WEAK))


def _body(vehicle: Vehicle) -> Iterator[Violation]:
    yield from _within(("com",), vehicle.com, vehicle.radius)
    yield from _inertia(vehicle)
    for name, largest in (
        ("drag", vehicle.mass / QUICKEST_STOP),
        ("spin_drag", vehicle.inertia / QUICKEST_SPIN_STOP),
    ):
        if (drag := getattr(vehicle, name)) > largest:
            expected = f"at most {largest:g}: with more it does not float"
            yield Violation((name,), expected, f"{drag:g}")


def _inertia(vehicle: Vehicle) -> Iterator[Violation]:
    """The mass is within the radius, so an inertia limits how far off the centre of mass is."""
    mass, inertia, radius = vehicle.mass, vehicle.inertia, vehicle.radius
    largest, least = mass * radius**2, DENSEST**2 * mass * radius**2
    found = f"{inertia:g} kg m^2"
    if inertia > largest:
        expected = f"at most {largest:g} kg m^2: {mass:g} kg within {radius:g} m"
        yield Violation(("inertia",), expected, found)
    elif math.hypot(*vehicle.com) > (furthest := math.sqrt(radius**2 - inertia / mass)):
        expected = (
            f"at most {furthest:.3g} m from the origin: {mass:g} kg within {radius:g} m with an"
            f" inertia of {inertia:g} kg m^2 are not further off"
        )
        yield Violation(("com",), expected, show(list(vehicle.com)))
    if inertia < least:
        expected = f"at least {least:g} kg m^2, or the mass is a point"
        yield Violation(("inertia",), expected, found)


def _air(vehicle: Vehicle) -> Iterator[Violation]:
    air = vehicle.air
    if air.gas >= 0.5 * vehicle.mass:
        expected = f"less than half of the mass, {0.5 * vehicle.mass:g} kg"
        yield Violation(("air", "gas"), expected, f"{air.gas:g} kg")
    arm = math.dist(air.tank_position, vehicle.com)
    if air.gas * arm**2 > 0.25 * vehicle.inertia:  # the gas is used up, and its inertia with it
        furthest = math.sqrt(0.25 * vehicle.inertia / air.gas)
        expected = f"at most {furthest:g} m from `com`, or the gas has the vehicle's inertia"
        yield Violation(("air", "tank_position"), expected, show(list(air.tank_position)))
    if air.tank_pressure < air.set_pressure + air.dropout:
        expected = f"at least set_pressure + dropout, {air.set_pressure + air.dropout:g} Pa"
        yield Violation(("air", "tank_pressure"), expected, f"{air.tank_pressure:g} Pa")


def _gauges(vehicle: Vehicle) -> Iterator[Violation]:
    gauges = vehicle.gauges
    if gauges.undervoltage_v > 0.0 and not gauges.battery:
        expected = "0 without a voltmeter (`battery = false`)"
        yield Violation(("gauges", "undervoltage_v"), expected, f"{gauges.undervoltage_v:g} V")
    if gauges.battery_v > HIGHEST_V:
        expected = f"volts, at most {HIGHEST_V:g}"
        yield Violation(("gauges", "battery_v"), expected, f"{gauges.battery_v:g}")
    if gauges.undervoltage_v > gauges.battery_v:
        expected = f"volts, at most those of the battery, battery_v = {gauges.battery_v:g}"
        yield Violation(("gauges", "undervoltage_v"), expected, f"{gauges.undervoltage_v:g}")


def _spread(vehicle: Vehicle) -> Iterator[Violation]:
    spread = vehicle.tolerance
    for name in ("thrust", "pulse", "mass", "inertia"):
        if (share := getattr(spread, name)) > 0.5:
            yield Violation(("tolerance", name), "a share, at most 0.5: 5 % is 0.05", f"{share:g}")
    if spread.direction_deg > MOST_SKEW:
        expected = f"degrees, at most {MOST_SKEW:g}"
        yield Violation(("tolerance", "direction_deg"), expected, f"{spread.direction_deg:g}")
    if spread.com > vehicle.radius:
        expected = f"at most the radius, {vehicle.radius:g} m"
        yield Violation(("tolerance", "com"), expected, f"{spread.com:g} m")
