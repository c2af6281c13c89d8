"""Speed of the twin in the reference run, everything on, and of `testbed --help`.

    python benchmarks/speed.py [--runs 5]

Ratios to real time, after compilation: with the log written to disk, and with every tick kept in
memory, both without garbage collection as every run has it; and the best of several starts of the
command.
"""

import argparse
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from testbed.config import Experiment, find, load
from testbed.flight.flown_span import FlownSpan
from testbed.flight.flown_tick import AnyHostTick, AnyTick
from testbed.realtime.scheduling import steady_memory
from testbed.rig.observers import NullObserver
from testbed.rig.twin import make_twin
from testbed.run.fly import fly_and_judge


class Memory(NullObserver):
    """Keeps all ticks."""

    def __init__(self) -> None:
        self.kept: list[AnyTick | AnyHostTick | FlownSpan] = []
        self.number = 0  # of ticks of vehicles and laws

    def vehicle(self, name: str, tick: AnyTick) -> None:
        """See `Observer`."""
        self.kept.append(tick)
        self.number += 1

    def host(self, name: str, tick: AnyHostTick) -> None:
        """See `Observer`."""
        self.kept.append(tick)
        self.number += 1

    def ticks(self, span: FlownSpan) -> None:
        """See `NullObserver`."""
        self.kept.append(span)
        self.number += len(span.times) * (len(span.vehicles) + len(span.hosts))


def in_memory(experiment: Experiment) -> float:
    """Speed against real time with every tick kept in memory."""
    rig, memory = make_twin(experiment), Memory()
    with steady_memory():
        began = time.perf_counter()
        rig.fly(memory)
        took = time.perf_counter() - began
    assert memory.number == 2 * experiment.ticks * len(experiment.vehicles)
    return experiment.end_s / took


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--runs", type=int, default=5)
    options = parser.parse_args()
    experiment = load(find("zhang2023_table"))
    factors = []
    for _ in range(options.runs):
        with tempfile.TemporaryDirectory() as folder:
            factors.append(fly_and_judge(experiment, Path(folder)).real_time_factor or 0.0)
    kept = [in_memory(experiment) for _ in range(options.runs)]
    print("zhang2023_table, 3 vehicles, 150 s, x real time")
    print(f"  log written      {min(factors):.0f}-{max(factors):.0f}")
    print(f"  kept in memory   {min(kept):.0f}-{max(kept):.0f}")
    command = Path(sys.executable).with_name("testbed")
    starts = []
    for _ in range(options.runs):
        began = time.perf_counter()
        subprocess.run([command, "--help"], check=True, stdout=subprocess.DEVNULL)
        starts.append(time.perf_counter() - began)
    print(f"testbed --help: best {1e3 * min(starts):.0f} ms, worst {1e3 * max(starts):.0f} ms")


if __name__ == "__main__":
    main()
