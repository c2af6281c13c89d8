"""zhang2023 in space: each satellite flies to its own goal, around its own obstacles."""

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from controllers.catalogue import Controller
from controllers.sotsmc import SotsmcParams
from sim_twin.orbit.relative import drift, frame_at
from testbed.core.vehicle import Positive
from testbed.metrics.formation import settled_after
from testbed.reproduction.compiled_law import gains_of
from testbed.reproduction.figure import Figure, Reading, thinned
from testbed.reproduction.kernel.fleet import FleetFlight, fly, wave_at
from testbed.reproduction.scene import STILL, Obstacles, OrbitParams, Vector, WaveParams, place
from testbed.reproduction.sliding import Trajectory, vanishing

Array = NDArray[np.float64]
Measures = dict[str, list[float | None]]

SETTLED = 0.1  # "reached": error that is not exceeded again [m]
REST = 100.0  # length of the steady phase at the end of a run [s]
BUSY = 3e-3  # control beyond the compensation of disturbance and orbit [m/s^2]
NEAR = 75.0  # "close to the obstacle": 1.5 times its danger radius [m]


class Satellite(Struct, frozen=True, forbid_unknown_fields=True):
    """One satellite of Table 1."""

    start: Vector  # [m]
    goal: Vector  # [m]
    obstacles: tuple[Vector, ...] = ()  # [m]


class Targets(Struct, frozen=True, forbid_unknown_fields=True, tag="targets"):
    """A simulation of section 4."""

    controller: Controller
    satellites: dict[str, Satellite]
    radius: Positive  # of the danger areas [m]
    orbit: OrbitParams
    duration_s: Positive
    step_s: Positive
    quick_step_s: Positive
    disturbance: WaveParams = STILL  # [m/s^2]
    law_knows_disturbance: bool = False  # the drift given to the law includes the disturbance
    mass: Positive = 1.0  # [kg]
    corrections: tuple[str, ...] = ()
    assumptions: tuple[str, ...] = ()


def fly_one(run: Targets, satellite: Satellite, step: float) -> FleetFlight:
    """Fly one satellite; the others do not affect it."""
    law = gains_of(run.controller, ["sat"], 3)
    obstacles = Obstacles(satellite.obstacles, run.radius)
    where = place(
        run.orbit, satellite.goal, obstacles=obstacles, push=run.disturbance,
        law_knows_rate=True, law_knows_push=run.law_knows_disturbance,
    )  # fmt: skip
    steps = round(run.duration_s / step)
    every = max(1, round(0.5 / step))
    start = np.array([satellite.start])
    return fly(
        law, where, np.array([run.mass]), start, np.zeros_like(start),
        step=step, steps=steps - steps % every, every=every,
    )  # fmt: skip


def motion_of(run: Targets, satellite: Satellite, flight: FleetFlight) -> Trajectory:
    """The trajectory with the accelerations known to the law."""
    chief, push = run.orbit.chief(), run.disturbance.wave()
    p, v = flight.p[:, 0], flight.v[:, 0]
    a = flight.wanted[:, 0] / run.mass
    for k, t in enumerate(flight.t):
        a[k] += drift(frame_at(chief, t), p[k], v[k])
        if run.law_knows_disturbance:
            a[k] += wave_at(push, t)
    obstacles = np.array(satellite.obstacles, dtype=float).reshape(-1, 3)
    return Trajectory(flight.t, p - np.array(satellite.goal), p, v, a, obstacles, run.radius)


def measure_one(run: Targets, satellite: Satellite, flight: FleetFlight) -> dict[str, float | None]:
    """Measures of one flight."""
    t, p = flight.t, flight.p[:, 0]
    error = np.linalg.norm(p - np.array(satellite.goal), axis=1)
    u = flight.wanted[:, 0] / run.mass
    found: dict[str, float | None] = {
        "settle_s": settled_after(t, error > SETTLED),
        "steady_error_m": float(error[t > t[-1] - REST].max()),
        "final_error_m": float(error[-1]),
        "moved_m": float(np.linalg.norm(p[-1] - p[0])),
        "peak_control": float(flight.peak.max() / run.mass),
        "control_s": settled_after(t, np.abs(u).max(axis=1) > BUSY),
        "vibration": float(flight.travel.sum() / run.mass),
    }
    if isinstance(run.controller, SotsmcParams):
        found |= vanishing(run.controller, motion_of(run, satellite, flight))
    gaps = [np.linalg.norm(p - np.array(obstacle), axis=1) for obstacle in satellite.obstacles]
    for k, gap in enumerate(gaps, 1):
        found[f"obstacle{k}_m"] = float(gap.min())
    if gaps:
        nearest = np.min(gaps, axis=0)
        size = np.abs(u).max(axis=1)
        found["obstacles_m"] = float(nearest.min())
        near = float(size[nearest < NEAR].max(initial=0.0))
        far = float(size[nearest >= NEAR].max(initial=0.0))
        found |= {"near_control": near, "far_control": far}
        found["near_to_far"] = near / far if far > 0.0 else None
    return found


def run_targets(run: Targets, *, quick: bool) -> tuple[Measures, list[Figure]]:
    """Fly all satellites; measures are called "sat1 settle_s" and so on."""
    step = run.quick_step_s if quick else run.step_s
    measures: Measures = {}
    curves: dict[str, dict[str, tuple[Array, Array]]] = {k: {} for k in ("d", "e", "g", "u", "xy")}
    ends = []
    for name, satellite in run.satellites.items():
        flight = fly_one(run, satellite, step)
        for what, value in measure_one(run, satellite, flight).items():
            measures[f"{name} {what}"] = [value]
        ends.append(flight.p[-1, 0])
        t, p = thinned(flight.t), thinned(flight.p[:, 0])
        for k, obstacle in enumerate(satellite.obstacles, 1):
            gap = np.linalg.norm(p - np.array(obstacle), axis=1)
            curves["d"][f"{name}, obstacle {k}"] = (t, gap)
        curves["xy"][name] = (p[:, 0], p[:, 1])
        curves["g"][name] = (t, np.linalg.norm(p - np.array(satellite.goal), axis=1))
        for k, axis in enumerate("xyz"):
            curves["e"][f"{name} {axis}"] = (t, p[:, k] - satellite.goal[k])
            curves["u"][f"{name} {axis}"] = (t, thinned(flight.wanted[:, 0, k]) / run.mass)
    sides = [np.linalg.norm(a - b) for i, a in enumerate(ends) for b in ends[:i]]
    if sides:
        measures["triangle_side_min_m"] = [float(min(sides))]
        measures["triangle_side_max_m"] = [float(max(sides))]
    radius = run.orbit.a_km * (1.0 - run.orbit.e)
    measures["perigee_km"] = [radius]
    return measures, [
        Figure("trajectory", "x [m]", "y [m]", curves["xy"], dots=True, circles=_circles(run)),
        Figure("distance to the obstacles", "time [s]", "distance [m]", curves["d"],
               readings=(Reading(("* obstacle*_m",)),)),
        Figure("relative position error", "time [s]", "error [m]", curves["e"]),
        Figure("distance to the goal", "time [s]", "distance [m], log scale", curves["g"], log=True,
               readings=(Reading(("* steady_error_m", "* final_error_m")),
                         Reading(("* settle_s",), "x"), Reading(("* error_decades",), ""))),
        Figure("controller output", "time [s]", "u [m/s^2]", curves["u"],
               readings=(Reading(("* peak_control",)), Reading(("* control_s",), "x"),
                         Reading(("* near_to_far", "* vibration"), ""))),
    ]  # fmt: skip


def _circles(run: Targets) -> tuple[tuple[float, float, float], ...]:
    """The obstacles of all satellites, seen along z."""
    every = [at for one in run.satellites.values() for at in one.obstacles]
    return tuple((x, y, run.radius) for x, y, _ in dict.fromkeys(every))
