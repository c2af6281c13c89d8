"""Duration of a vehicle's tick on board, in flight, beside an earlier version.

    python benchmarks/chain.py [--before CHECKOUT] [--rounds 3]

zhang2023_table, three vehicles, fault monitor and safety filter on, law on the host. Printed is the
lower quartile of each call in microseconds, which other work on the machine disturbs least: of
`Agent.step`, structs in and out, and of the compiled chain in it, where there is one. CHECKOUT is a
folder with an earlier version; both fly in turns, and the ratio is printed, too.
"""

import argparse
import json
import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[1]


def timed(function, times: list[float]):
    """Wrap a function so that its durations are recorded [s]."""

    def call(*args):
        began = time.perf_counter()
        try:
            return function(*args)
        finally:
            times.append(time.perf_counter() - began)

    return call


def measure(seconds: float) -> dict[str, float]:
    """Lower quartiles of one flight [us]."""
    from testbed.config import find, load  # of the version that PYTHONPATH names
    from testbed.flight.agent import Agent
    from testbed.realtime.scheduling import no_garbage_collection
    from testbed.rig.observers import NullObserver
    from testbed.rig.twin import make_twin, warm_up

    experiment = load(find("zhang2023_table"), [f"duration_s={seconds}"])
    warm_up(experiment)
    ticks: list[float] = []
    compiled: list[float] = []
    Agent.step = timed(Agent.step, ticks)
    rig = make_twin(experiment)
    for node in rig.vehicles:
        agent = node._agent
        if hasattr(agent, "memory"):
            agent._step = timed(agent._step, compiled)
    with no_garbage_collection():
        rig.fly(NullObserver())
    found = {"Agent.step": ticks, "chain.step": compiled}
    return {name: 1e6 * float(np.quantile(t[100:], 0.25)) for name, t in found.items() if t}


def in_checkout(folder: Path, seconds: float) -> dict[str, float]:
    """Measure the version in a folder, in a separate process."""
    words = [sys.executable, __file__, "--here", "--seconds", str(seconds)]
    env = os.environ | {"PYTHONPATH": str(folder)}
    out = subprocess.run(words, env=env, cwd=folder, capture_output=True, text=True, check=True)
    return json.loads(out.stdout)


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--before", type=Path)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--here", action="store_true", help="measure the version of PYTHONPATH")
    options = parser.parse_args()
    if options.here:
        print(json.dumps(measure(options.seconds)))
        return
    best: dict[str, float] = {}
    for _ in range(options.rounds):
        for folder in (ROOT, options.before):
            if folder is None:
                continue
            for name, took in in_checkout(folder.resolve(), options.seconds).items():
                label = name if folder == ROOT else f"before: {name}"
                best[label] = min(took, best.get(label, np.inf))
    for label, took in best.items():
        print(f"{label:<20} {took:6.1f} us")
    if options.before is not None:
        ratio = best["before: Agent.step"] / best["Agent.step"]
        print(f"Agent.step is {ratio:.1f} times as fast")


if __name__ == "__main__":
    main()
