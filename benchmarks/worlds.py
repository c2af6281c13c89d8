"""Seconds flown by vehicles per second of processor time, beside crazyflow's many worlds.

    python benchmarks/worlds.py [--rounds 5] [--crazyflow PYTHON] [--worlds 10000]

Ours is `hold`, a vehicle under pd control with everything on: cameras, links, estimator, detectors,
safety filter, boards and exact pulses, at 10 Hz and in memory. crazyflow's are quadrotors under
state control at 500 Hz, integrated by JAX on the processor, without sensors; `--crazyflow` is the
Python of an environment of its own that has it (`pip install crazyflow`). They take turns.
"""

import argparse
import subprocess
import time

from testbed.config import find, load
from testbed.realtime.scheduling import steady_memory
from testbed.rig.observers import MetricsObserver
from testbed.rig.twin import make_twin

CRAZYFLOW = """
import sys, time
import numpy as np
from crazyflow.control import Control
from crazyflow.sim import Sim
worlds, seconds = int(sys.argv[1]), 0.5
sim = Sim(n_worlds=worlds, n_drones=1, control=Control.state, device="cpu")
sim.reset()
order = np.zeros((worlds, 1, 16))
order[..., 2], order[..., 12] = 0.5, 1.0  # height, quaternion
def fly():
    for _ in range(int(seconds * 100)):
        sim.state_control(order)
        sim.step(sim.freq // 100)
    sim.data.states.pos.block_until_ready()
fly()
began = time.process_time()
fly()
print(worlds * seconds / (time.process_time() - began))
"""


def ours(experiment) -> float:
    """Vehicle-seconds per second of processor time of one flight."""
    rig, judge = make_twin(experiment), MetricsObserver(experiment.vehicles)
    with steady_memory():
        began = time.process_time()
        ending = rig.fly(judge)
        took = time.process_time() - began
    return ending.t * len(experiment.vehicles) / took


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--crazyflow", metavar="PYTHON")
    parser.add_argument("--worlds", type=int, default=10_000)
    options = parser.parse_args()
    experiment = load(find("hold"))
    ours(experiment)
    rates, theirs = [], []
    for _ in range(options.rounds):
        rates.append(ours(experiment))
        if options.crazyflow:
            words = [options.crazyflow, "-c", CRAZYFLOW, str(options.worlds)]
            done = subprocess.run(words, capture_output=True, text=True, check=True)
            theirs.append(float(done.stdout.split()[-1]))  # after what its imports print
    print("vehicle-seconds per second of processor time")
    print(f"  hold, one vehicle, pd, everything on     {min(rates):.0f}-{max(rates):.0f}")
    if theirs:
        print(f"  crazyflow, {options.worlds} worlds{min(theirs):18.0f}-{max(theirs):.0f}")


if __name__ == "__main__":
    main()
