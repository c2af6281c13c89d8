"""Warns about implausible parts of a vehicle: jets listed twice, exhaust, pulses, drag, landing.

Only `testbed check` prints these, like those of `plausibility`.
"""

import math
from collections.abc import Iterator, Sequence
from itertools import combinations

from msgspec.structs import replace

from controllers.pd import PdParams
from testbed.config.experiment import Experiment
from testbed.core.landing import GRAVITY, landing_delay
from testbed.core.vehicle import Air, Jet, Landing, Valve, Vehicle
from testbed.flight.allocation import weakest_force
from testbed.flight.modulation import PwmParams
from testbed.flight.plan import planner_of

SAME_PLACE = 1e-3  # jets nearer than this are one [m]
SAME_WAY = math.radians(1.0)  # pushes with a smaller angle between them are one [rad]
LEAST_EXHAUST, MOST_EXHAUST = 200.0, 3000.0  # below air at 1 bar, above hydrogen [m/s]
COARSE = 0.7  # of the jet period: U. Kentucky's shortest pulse is 0.6 of it
SHORTEST_COAST = 1.0  # time constant of drag; U. Kentucky's turns stop with 1.1 s [s]
FASTEST_LANDING = 2.0  # [m/s]
STEEPEST_LANDING = 0.1  # 0.6 deg; shipped tables have up to 0.02 [m/s^2]
MOST_FRICTION = 1.0  # rubber on stone
SOONER = 0.02  # of a landing: 4 mm at 0.2 m/s [s]
OFF = 0.05  # distance from the goal at which no jet fires [m] [assumption]


def doubtful_parts(experiment: Experiment, vehicle: Vehicle) -> Iterator[tuple[str, str]]:
    """Name and text of each warning about a vehicle's parts."""
    yield from _same_jets(vehicle.jets)
    yield from _plumes(vehicle.jets)
    yield from _exhaust(vehicle.air)
    yield from _pulse(vehicle.valve, experiment.flight.jet_period_s)
    yield from _dead_band(experiment, vehicle)
    yield from _drag(vehicle)
    yield from _landing(vehicle.landing, min(experiment.table.size))
    yield from _late_landing(experiment, vehicle.landing)


def _same_jets(jets: Sequence[Jet]) -> Iterator[tuple[str, str]]:
    pairs = [
        f"{i} and {k}"
        for (i, one), (k, other) in combinations(enumerate(jets, 1), 2)
        if math.dist(one.position, other.position) < SAME_PLACE
        and math.dist(one.push, other.push) < SAME_WAY
    ]
    if pairs:
        text = f"jets {', '.join(pairs)} are at the same place and push the same way: listed twice?"
        yield "jets-twice", text


def _plumes(jets: Sequence[Jet]) -> Iterator[tuple[str, str]]:
    """Warn if every plume blows over the vehicle: then `push` is probably the plume's direction."""
    outwards = [x * px + y * py for (x, y), (px, py) in ((one.position, one.push) for one in jets)]
    if outwards and min(outwards) > SAME_PLACE:
        yield (
            "jets-turned",
            "each jet pushes away from the vehicle's middle, so its plume blows over the vehicle:"
            " `push` is where the body goes, opposite to the plume",
        )


def _exhaust(air: Air) -> Iterator[tuple[str, str]]:
    speed = air.exhaust_speed
    if not LEAST_EXHAUST <= speed <= MOST_EXHAUST:
        yield (
            "exhaust-speed",
            f"air.exhaust_speed is {speed:g} m/s: cold gas has 400 to 750 m/s (air, nitrogen), up"
            f" to {MOST_EXHAUST:g} m/s (hydrogen); a specific impulse of {speed:g} s would be"
            f" {speed * GRAVITY:.3g} m/s",
        )


def _pulse(valve: Valve, period: float) -> Iterator[tuple[str, str]]:
    if valve.min_on_s >= COARSE * period:
        yield (
            "pulse",
            f"valve.min_on_s is {1e3 * valve.min_on_s:g} ms of the {1e3 * period:g} ms of"
            " flight.jet_period_s: a jet gives almost its whole thrust or nothing",
        )


def _dead_band(experiment: Experiment, vehicle: Vehicle) -> Iterator[tuple[str, str]]:
    """Pulse width alone rounds small demands to nothing: the vehicle stays where it demands them.

    The position loop demands w^2 d at a distance of d.
    """
    flight, period = experiment.flight, experiment.flight.jet_period_s
    if not isinstance(flight.modulator, PwmParams):
        return
    modulator = planner_of(flight.modulator, vehicle, period).modulator
    fits = modulator.min_on <= period - 2.0 * modulator.min_off
    share = 0.5 * (modulator.min_on / period if fits else 1.0)
    loop = flight.tracker.bandwidth
    if experiment.guidance.mode == "wrench":
        if not isinstance(experiment.controller, PdParams):
            return
        loop = experiment.controller.bandwidth
    accel = share * weakest_force(vehicle) / vehicle.mass
    if accel > OFF * loop**2:
        whole = "" if fits else ", as a pulse with its pauses does not fit in a jet period"
        yield (
            "dead-band",
            f"pwm fires nothing below {share:.0%} of a jet's thrust{whole}: that is"
            f" {accel:.2g} m/s^2, and at {loop:.2g} rad/s the vehicle may stay"
            f" {accel / loop**2:.2g} m from its goal. sigma_delta has no dead band",
        )


def _drag(vehicle: Vehicle) -> Iterator[tuple[str, str]]:
    for name, unit, mass in (
        ("drag", "N s/m", vehicle.mass), ("spin_drag", "N m s/rad", vehicle.inertia),
    ):  # fmt: skip
        if (drag := getattr(vehicle, name)) * SHORTEST_COAST > mass:
            yield (
                "drag",
                f"{name} is {drag:g} {unit}, a time constant of {mass / drag:.2g} s:"
                " on air bearings a vehicle coasts for longer",
            )


def _landing(landing: Landing, side: float) -> Iterator[tuple[str, str]]:
    """Warn about a landing; `side` is the shorter one of the table [m]."""
    for name, value, most, unit, compared in (
        ("speed", landing.speed, FASTEST_LANDING, " m/s", "vehicles fly with 0.2 m/s; mm/s meant?"),
        ("slope", landing.slope, STEEPEST_LANDING, " m/s^2",
         "a tilt of 0.1 deg is 0.017 m/s^2; degrees meant?"),
        ("room", landing.room, 0.5 * side, " m",
         f"the table's shorter side is {side:g} m; mm meant?"),
        ("friction", landing.friction, MOST_FRICTION, "",
         "a coefficient, graphite on granite has 0.1; percent meant?"),
    ):  # fmt: skip
        if value > most:
            yield "landing", f"landing.{name} is {value:g}{unit}: {compared}"


def _late_landing(experiment: Experiment, landing: Landing) -> Iterator[tuple[str, str]]:
    """Warn if the board turns the air off too late for this table and this speed."""
    table, speed = experiment.table, experiment.flight.barrier.max_speed
    slope = max(table.tilt.steepest, landing.slope)
    here = replace(landing, speed=max(speed, landing.speed), slope=slope)
    planned, needed = landing_delay(landing), landing_delay(here)
    if planned > needed + SOONER:
        yield (
            "landing",
            f"the board turns the air off {planned:.2g} s after its watchdog; at {here.speed:g} m/s"
            f" on a slope of {here.slope:.2g} m/s^2 it would have to after {needed:.2g} s, to stop"
            f" within landing.room, {landing.room:g} m: landing.speed is {landing.speed:g} m/s,"
            f" landing.slope {landing.slope:g} m/s^2",
        )
