"""gao2022's 50 satellites, two-body + J2 over 2000 s: this project's flights and Basilisk's.

    pip install '.[peers]'
    python benchmarks/swarm.py [--runs 5]

Both propagate the same uncontrolled satellites with the same constants; Basilisk with its default
integrator at a step of 1 s, as its users run it. Beside that, the paper's closed loop: a circle of
0.5 km out of a ball of 0.1 km (section 3.1.2), in both readings of its unit of force. Printed: wall
times in the same run, after compilation; the closed loop's share of Basilisk's time; and the
largest distance between the two uncontrolled flights after 2000 s.
"""

import argparse
import math
import os
import sys
import tempfile
import time
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from controllers.bifurcating import Phase
from sim_twin.orbit.frames import NADIR
from sim_twin.orbit.gravity import EARTH
from sim_twin.orbit.kepler import Orbit
from sim_twin.orbit.swarm import Flight, fly
from sim_twin.orbit.system import Coast
from testbed.reproduction.cluster import ball
from testbed.reproduction.kernel.cluster import cluster, in_metres

Array = NDArray[np.float64]

# Section 3 of gao2022: 50 satellites near a centre at 600 km, 98 degrees, e = 0.0002
COUNT = 50
CENTRE = Orbit(a=EARTH.radius + 600e3, e=0.0002, i=math.radians(98.0))
SIZE = 500.0  # [m]
SECONDS = 2000.0
SAMPLE = 10.0  # [s]
MASS = 100.0  # [kg]
AIRSPACE = 100.0  # [m]
CIRCLE = Phase(  # section 3.1.2, lengths in km; sigma is not printed
    a=1.0, b=1.0, r=0.5, mu=-5.0, k_f=3.0, k_v=2000.0, k_c=0.25, s=0.5, sigma=5.0
)
UNITS = {"N": 1.0, "kN": 1000.0}  # readings of the paper's force
TOLERANCES = (1e-8, 1e-9)  # relative; for whom the closed loop is timed


def start(seed: int = 0) -> tuple[Array, Array]:
    """Positions in a ball of `SIZE`, at rest in the centre's frame, (n, 3) [m], [m/s]."""
    rng = np.random.default_rng(seed)
    p = rng.normal(size=(COUNT, 3))
    p *= SIZE * (rng.uniform(size=COUNT) ** (1.0 / 3.0) / np.linalg.norm(p, axis=1))[:, None]
    return p, np.zeros_like(p)


def ours(control: NamedTuple) -> Flight:
    """Fly under a control of `sim_twin.orbit.system`; `Coast()` is free flight."""
    times = np.arange(0.0, SECONDS + 0.5 * SAMPLE, SAMPLE)
    return fly(control, np.concatenate(CENTRE.eci()), *start(), times, axes=NADIR)


def closed_loop(newtons: float, rtol: float) -> Flight:
    """Fly the circle's control."""
    control = cluster((in_metres(CIRCLE, newtons),), MASS, CENTRE.mean_motion)
    p = ball(AIRSPACE, 0, COUNT)
    times = np.arange(0.0, SECONDS + 0.5 * SAMPLE, SAMPLE)
    hub = np.concatenate(CENTRE.eci())
    return fly(control, hub, p, np.zeros_like(p), times, axes=NADIR, rtol=rtol, atol=1e5 * rtol)


def timed(runs: int, rtol: float, newtons: float) -> tuple[list[float], Flight]:
    """Wall times of the closed loop [s], and one of its flights."""
    walls = []
    for _ in range(runs):
        began = time.perf_counter()
        flight = closed_loop(newtons, rtol)
        walls.append(time.perf_counter() - began)
    return walls, flight


def gravity_file(folder: Path) -> Path:
    """The constants of `EARTH` as Basilisk reads them: normalised coefficients up to degree 2."""
    lines = [f"{EARTH.radius!r},{EARTH.mu!r},0.0,2,2,1,0,0", "0,0,1.0,0.0", "1,0,0.0,0.0"]
    lines += [
        "1,1,0.0,0.0",
        f"2,0,{-EARTH.j2 / math.sqrt(5.0)!r},0.0",
        "2,1,0.0,0.0",
        "2,2,0.0,0.0",
    ]
    path = folder / "two_body_and_j2.txt"
    path.write_text("\n".join(lines) + "\n")
    return path


def basilisk(r: Array, v: Array) -> tuple[Array, float, float]:
    """Fly the satellites in Basilisk: positions after 2000 s, wall time, time to set up [s]."""
    from Basilisk.simulation import spacecraft
    from Basilisk.utilities import SimulationBaseClass, macros, simIncludeGravBody

    began = time.perf_counter()
    simulation = SimulationBaseClass.SimBaseClass()
    process = simulation.CreateNewProcess("process")
    process.addTask(simulation.CreateNewTask("task", macros.sec2nano(1.0)))
    factory = simIncludeGravBody.gravBodyFactory()
    earth = factory.createEarth()
    earth.isCentralBody = True
    earth.mu, earth.radEquator = EARTH.mu, EARTH.radius
    with tempfile.TemporaryDirectory() as folder:
        earth.useSphericalHarmonicsGravityModel(str(gravity_file(Path(folder))), 2)
    satellites = []
    for k in range(len(r)):
        satellite = spacecraft.Spacecraft()
        satellite.ModelTag = f"satellite {k}"
        factory.addBodiesTo(satellite)
        satellite.hub.r_CN_NInit = r[k].tolist()
        satellite.hub.v_CN_NInit = v[k].tolist()
        simulation.AddModelToTask("task", satellite)
        satellites.append(satellite)
    simulation.InitializeSimulation()
    simulation.ConfigureStopTime(macros.sec2nano(SECONDS))
    ready = time.perf_counter()
    simulation.ExecuteSimulation()
    wall = time.perf_counter() - ready
    return np.array([s.scStateOutMsg.read().r_BN_N for s in satellites]), wall, ready - began


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--runs", type=int, default=5)
    options = parser.parse_args()
    print(f"load of the machine {os.getloadavg()[0]:.2f}, {os.cpu_count()} cores")
    flight = ours(Coast())  # compiles
    walls = []
    for _ in range(options.runs):
        began = time.perf_counter()
        flight = ours(Coast())
        walls.append(time.perf_counter() - began)
    print(
        f"{COUNT} satellites, two-body + J2, {SECONDS:.0f} s, uncontrolled, sampled every "
        f"{SAMPLE:.0f} s: {1e3 * min(walls):.2f}-{1e3 * max(walls):.2f} ms, {flight.steps} steps"
    )
    closed_loop(1.0, 1e-6)  # compiles
    loops = {
        (unit, rtol): timed(options.runs, rtol, newtons)
        for unit, newtons in UNITS.items()
        for rtol in TOLERANCES
    }
    try:
        import Basilisk
    except ImportError:
        sys.exit("Basilisk is not installed, so there is nothing to compare with: pip install bsk")
    theirs = [basilisk(flight.r[0], flight.v[0]) for _ in range(options.runs)]
    walls = [wall for _, wall, _ in theirs]
    print(
        f"Basilisk {Basilisk.__version__}, default integrator, 1 s step: "
        f"{1e3 * min(walls):.0f}-{1e3 * max(walls):.0f} ms, "
        f"and {1e3 * min(t for _, _, t in theirs):.0f} ms to set up"
    )
    best = min(walls)
    for (unit, rtol), (ours_walls, loop) in loops.items():
        radius = np.hypot(loop.p[-1, :, 0], loop.p[-1, :, 2]).mean()
        print(
            f"closed loop, force in {unit}, rtol {rtol:g}: {1e3 * min(ours_walls):.0f}-"
            f"{1e3 * max(ours_walls):.0f} ms, {loop.evaluations} evaluations, "
            f"{min(ours_walls) / best:.2f} of Basilisk's; circle of {radius:.1f} m"
        )
    gap = np.linalg.norm(theirs[0][0] - flight.r[-1], axis=1).max()
    print(f"largest distance between the two after {SECONDS:.0f} s: {gap:.2e} m")


if __name__ == "__main__":
    main()
