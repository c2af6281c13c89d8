"""gao2022: formation flying of fifty satellites in ECI under J2.

Measures, one value per seed; "at T" is for every time T of `times` [s] (whole seconds):

    error_m at T        largest distance of a satellite from the formation (first order)
    error_mean_m at T   mean of it
    radius_m at T       mean distance from the centre in the plane
    plane_m at T        largest distance from the plane
    outer_m, inner_m, uniformity at T   of the five elements
    inside, outside at T    number of satellites within, beyond a b r
    depth at T          mean distance from the middle over the largest: full ball 3/4, shell 1
    arrived_s           when the mean distance to it first is below `formed_m`
    formed_s            after which the mean distance to it stays below `formed_m`
    spent_ms            total velocity increment per axis, largest of all satellites
    window_ms           velocity increment per axis within any 10 s, largest of all satellites
    inner_ever_m        smallest distance between two satellites
    overshoot_m         overshoot of the mean radius beyond its last value
    switched_rank       only with two or more phases: of the satellites outside in the last phase,
                        the share that was further out than the median before that phase began
"""

import math
from typing import Literal

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from controllers.bifurcating import Phase
from sim_twin.orbit.frames import NADIR
from sim_twin.orbit.gravity import EARTH
from sim_twin.orbit.kepler import Orbit
from sim_twin.orbit.swarm import Flight, fly
from testbed.core.vehicle import Positive
from testbed.metrics.characterisation import characterise
from testbed.metrics.formation import settled_after
from testbed.reproduction.figure import Figure, Reading
from testbed.reproduction.kernel.cluster import (
    ATTRACT,
    INERTIAL,
    POTENTIAL,
    RIGHT,
    Cluster,
    cluster,
    in_metres,
)
from testbed.reproduction.targets import Measures

Array = NDArray[np.float64]

COUNT, MASS = 50, 100.0  # section 3 [-], [kg]
CENTRE = Orbit(a=EARTH.radius + 600e3, e=0.0002, i=math.radians(98.0))  # section 3.1
WINDOW = 10.0  # [s]
PRINTS = {"nothing": RIGHT, "13": ATTRACT, "12": POTENTIAL, "10": INERTIAL}


class Swarming(Struct, frozen=True, forbid_unknown_fields=True, tag="swarming"):
    """A simulation of section 3; lengths of `phases` in km as in the paper."""

    phases: tuple[Phase, ...]
    newtons: Literal[1, 1000]  # the paper's unit of force [N]
    duration_s: Positive = 2000.0
    sample_s: Positive = 10.0
    times: tuple[int, ...] = (2000,)  # [s]
    seeds: int = 3
    quick_seeds: int = 1
    airspace_m: Positive = 100.0  # radius of the ball of initial positions
    formed_m: Positive = 25.0
    uncorrected: Literal["nothing", "13", "12", "10"] = "nothing"
    corrections: tuple[str, ...] = ()
    assumptions: tuple[str, ...] = ()


def ball(radius: float, seed: int, count: int = COUNT) -> Array:
    """Uniformly random positions in a ball, (count, 3) [m]."""
    rng = np.random.default_rng([seed, 2022])
    p = rng.normal(size=(count, 3))
    return p * (
        radius * (rng.uniform(size=count) ** (1.0 / 3.0) / np.linalg.norm(p, axis=1))[:, None]
    )


def control_of(run: Swarming) -> Cluster:
    """The law in SI units."""
    phases = tuple(in_metres(phase, run.newtons) for phase in run.phases)
    control = cluster(phases, MASS, CENTRE.mean_motion)
    speed = float(np.linalg.norm(CENTRE.eci()[1]))
    return control._replace(speed=speed, as_printed=PRINTS[run.uncorrected])


def fly_seed(run: Swarming, seed: int) -> Flight:
    """Fly from rest at random positions in a ball, relative to the centre."""
    p = ball(run.airspace_m, seed)
    times = np.arange(0.0, run.duration_s + 0.5 * run.sample_s, run.sample_s)
    hub = np.concatenate(CENTRE.eci())
    return fly(
        control_of(run), hub, p, np.zeros_like(p), times, axes=NADIR, rtol=1e-8, atol=1e-3,
    )  # fmt: skip


def distance_to(phase: Phase, p: Array) -> Array:
    """First-order distance to a formation given in km, p of shape (..., 3) [m]; shape (...) [m]."""
    a, b, c = float(phase.a or 0.0), float(phase.b or 0.0), phase.c
    r, mu = float(phase.r or 0.0), float(phase.mu or 0.0)
    if c is None:
        weight, level = np.array([b * b, 0.0, a * a]), 1e3 * a * b * r
    else:
        weight = np.array([(b * c) ** 2, (a * c) ** 2, (a * b) ** 2])
        level = 1e3 * a * b * c * r
    q = np.sqrt((weight * p**2).sum(axis=-1))
    slope = np.sqrt((weight**2 * p**2).sum(axis=-1)) / np.maximum(q, 1e-9)
    return np.abs(np.abs(q - level) - max(1e3 * mu, 0.0)) / np.maximum(slope, 1e-9)


def level_of(phase: Phase, p: Array) -> Array:
    """Q / (a b r) of a planar formation: 1 on the curve of size r."""
    a, b, r = float(phase.a or 0.0), float(phase.b or 0.0), float(phase.r or 0.0)
    q = np.hypot(b * p[..., 0], a * p[..., 2])
    return q / (1e3 * a * b * r) if a * b * r > 0.0 else np.ones(p.shape[:-1])


def reached(t: Array, off: NDArray[np.bool_]) -> float | None:
    """First time at which a sample is not `off`; None if all are."""
    there = np.flatnonzero(~off)
    return float(t[there[0]]) if len(there) else None


def snapshot(phase: Phase, p: Array, v: Array) -> dict[str, float]:
    """Error, size and five elements of the cluster at one time."""
    error, level = distance_to(phase, p), level_of(phase, p)
    five = characterise(p, v)
    return {
        "error_m": float(error.max()),
        "error_mean_m": float(error.mean()),
        "radius_m": float(np.hypot(p[:, 0], p[:, 2]).mean()),
        "plane_m": float(np.abs(p[:, 1]).max()),
        "outer_m": five.outer,
        "inner_m": five.inner or 0.0,
        "uniformity": five.uniformity or 0.0,
        "depth": float(np.linalg.norm(p - p.mean(axis=0), axis=1).mean()) / five.outer,
        "inside": float((level < 1.0).sum()),
        "outside": float((level > 1.0).sum()),
    }


def measure(run: Swarming, f: Flight) -> dict[str, float | None]:
    """Measures of one flight."""
    t: Array = run.sample_s * np.arange(len(f.p), dtype=float)
    last = run.phases[-1]
    since = t >= last.at
    found: dict[str, float | None] = {}
    for at in run.times:
        k = round(at / run.sample_s)
        phase = [phase for phase in run.phases if phase.at <= max(at - 1e-6, 0.0)][-1]
        found |= {f"{n} at {at}": x for n, x in snapshot(phase, f.p[k], f.q[k]).items()}
    off = distance_to(last, f.p).mean(axis=1) > run.formed_m
    after = settled_after(t[since], off[since])
    found["formed_s"] = None if after is None else after - last.at
    first = reached(t[since], off[since])
    found["arrived_s"] = None if first is None else first - last.at
    found["spent_ms"] = float(f.spent[-1].max())
    found["spent_mean_ms"] = float(f.spent[-1].mean())
    w = max(1, round(WINDOW / run.sample_s))
    found["window_ms"] = float((f.spent[w:] - f.spent[:-w]).max())
    radius = np.hypot(f.p[:, :, 0], f.p[:, :, 2]).mean(axis=1)
    found["overshoot_m"] = float(radius[since].max() - radius[-1])
    found["inner_ever_m"] = min(_inner(p) for p in f.p)
    if len(run.phases) > 1:
        k = int(np.flatnonzero(since)[0])
        before = level_of(last, f.p[k])
        out = level_of(last, f.p[-1]) > 1.0
        found["switched_rank"] = (
            float((before[out] > np.median(before)).mean()) if out.any() and not out.all() else None
        )
    return found


def _inner(p: Array) -> float:
    return characterise(p).inner or 0.0


def run_swarming(run: Swarming, *, quick: bool) -> tuple[Measures, list[Figure]]:
    """Fly all seeds; measures are undefined if the integration fails."""
    seeds = run.quick_seeds if quick else run.seeds
    flights = [fly_seed(run, seed) for seed in range(seeds)]
    rows = [measure(run, f) for f in flights]
    return {name: [row[name] for row in rows] for name in rows[0]}, figures(run, flights[0])


def figures(run: Swarming, f: Flight) -> list[Figure]:
    """Figures of trajectories, distances, uniformity and velocity increments."""
    t: Array = run.sample_s * np.arange(len(f.p), dtype=float)
    ways = {f"{i + 1}": (f.p[:, i, 0] / 1e3, f.p[:, i, 2] / 1e3) for i in range(f.p.shape[1])}
    five = [characterise(p) for p in f.p]
    apart = {
        "largest distance from the middle": (t, np.array([one.outer for one in five])),
        "smallest distance of two": (t, np.array([one.inner or np.nan for one in five])),
    }
    even = np.array([one.uniformity or 0.0 for one in five])
    last = max(phase.at for phase in run.phases)
    off = distance_to(run.phases[-1], f.p[t >= last]).mean(axis=1)
    spent = {axis: (t, f.spent[:, :, k].max(axis=1)) for k, axis in enumerate(("x", "y", "z"))}
    seen = ("plane_m at *", "radius_m at *", "inside at *", "outside at *", "depth at *",
            "switched_rank", "overshoot_m")  # fmt: skip
    return [
        Figure("relative motion", "x [km]", "z [km]", ways, dots=True,
               shapes=tuple(shapes_of(run.phases[-1])), readings=(Reading(seen, ""),)),
        Figure("distance from the formation", "time [s]", "mean distance [m], log scale",
               {"mean of all satellites": (t[t >= last], off)}, log=True,
               readings=(Reading(("error_mean_m at *",)),
                         Reading(("arrived_s", "formed_s"), ""))),
        Figure("extent", "time [s]", "distance [m], log scale", apart, log=True,
               readings=(Reading(("outer_m at *", "inner_m at *", "inner_ever_m")),)),
        Figure("distribution uniformity", "time [s]", "L, log scale", {"L": (t, even)}, log=True,
               readings=(Reading(("uniformity at *",)),)),
        Figure("velocity increment, the most of all", "time [s]", "[m/s]", spent,
               readings=(Reading(("spent_ms",)), Reading(("window_ms",), ""))),
    ]  # fmt: skip


def shapes_of(phase: Phase) -> list[tuple[Array, Array]]:
    """The curves of a planar phase, x and z [km]; none of a line, which is free along x."""
    a, b, r = float(phase.a or 0.0), float(phase.b or 0.0), float(phase.r or 0.0)
    if phase.c is not None or a * b * r <= 0.0:
        return []
    around, mu = np.linspace(0.0, 2.0 * np.pi, 181), max(float(phase.mu or 0.0), 0.0)
    sizes = dict.fromkeys((a * b * r - mu, a * b * r + mu))  # Eq. (22): rho = +-mu, or 0
    return [(q / b * np.cos(around), q / a * np.sin(around)) for q in sizes if q > 0.0]
