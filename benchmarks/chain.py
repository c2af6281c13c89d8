"""Duration of a vehicle's tick on board, in flight.

    python benchmarks/chain.py [--experiment zhang2023_table] [--seconds 60] [--rounds 3]

The flight is flown on the twin; its first vehicle then flies again with what it heard, tick by
tick, as on the bench. Fault monitor and safety filter are on, the law is on the host. Printed are
quantiles in microseconds of the best round, because other work on the machine disturbs: of
`Agent.step`, structs in and out, and of the compiled chain in it.
"""

import argparse
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from testbed.config import Experiment, find, load
from testbed.core.types import Inputs
from testbed.realtime.scheduling import steady_memory
from testbed.rig.chain import make_agent
from testbed.rig.observers import NullObserver
from testbed.rig.twin import make_twin

STARTED = 100  # first ticks, which are not counted
SHARES = (0.25, 0.5, 0.99)


class Ear(NullObserver):
    """Keeps what a vehicle heard."""

    def __init__(self, name: str) -> None:
        self._name, self.heard = name, list[Inputs]()

    def vehicle(self, name: str, tick: Any) -> None:
        """A vehicle's tick."""
        if name == self._name:
            self.heard.append(tick.inputs)


def timed(function: Callable[..., Any], times: list[float]) -> Callable[..., Any]:
    """Wrap a function so that its durations are recorded [s]."""

    def call(*args: Any) -> Any:
        began = time.perf_counter()
        try:
            return function(*args)
        finally:
            times.append(time.perf_counter() - began)

    return call


def measure(experiment: Experiment, name: str, heard: list[Inputs]) -> dict[str, list[float]]:
    """Quantiles of one flight [us]."""
    agent = make_agent(experiment, name)
    ticks, seen, acted = list[float](), list[float](), list[float]()
    agent._see, agent._act = timed(agent._see, seen), timed(agent._act, acted)
    step = timed(agent.step, ticks)
    with steady_memory():
        for inputs in heard:
            step(inputs)
    found = {"Agent.step": ticks, "chain": [sum(pair) for pair in zip(seen, acted, strict=True)]}
    return {
        name: [1e6 * float(q) for q in np.quantile(t[STARTED:], SHARES)]
        for name, t in found.items()
    }


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--experiment", default="zhang2023_table")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--seconds", type=float, default=60.0)
    options = parser.parse_args()
    experiment = load(find(options.experiment), [f"duration_s={options.seconds}"])
    name = next(iter(experiment.vehicles))
    ear = Ear(name)
    make_twin(experiment).fly(ear)
    rounds = [measure(experiment, name, ear.heard) for _ in range(options.rounds)]
    print(f"{len(ear.heard)} ticks of {name}" + "".join(f"{f'p{1e2 * q:g}':>9}" for q in SHARES))
    for what in rounds[0]:
        best = min((one[what] for one in rounds), key=lambda row: row[0])
        print(f"  {what:<20}" + "".join(f"{one:8.1f} " for one in best) + "us")


if __name__ == "__main__":
    main()
