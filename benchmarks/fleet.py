"""Cost of a vehicle among ten and among a hundred: law on board, a radio range of 2.5 m.

    python benchmarks/fleet.py [--seconds 10] [--rounds 3]

Vehicles stand on a grid of 2 m and move to goals half a metre on, each under zhang2023's law among
the others that it hears; the table is as large as it takes. The fleets take turns, so that a busy
machine is busy for both; what counts is the ratio of processor time per vehicle and second.
"""

import argparse
import math
import tempfile
import time
from pathlib import Path

import tomli_w

from testbed.config import dump, find, load
from testbed.realtime.scheduling import steady_memory
from testbed.rig.observers import NullObserver
from testbed.rig.twin import make_twin

SPACING, STEP, RANGE, RIM = 2.0, 0.5, 2.5, 1.5  # [m]


def fleet(count, seconds):
    """An experiment with so many vehicles."""
    tree = dump(load(find("zhang2023_table")))
    columns = math.ceil(math.sqrt(count))
    width, depth = columns, math.ceil(count / columns)
    model = tree["vehicles"]["sat1"]["model"]
    tree["vehicles"], tree["obstacles"], tree["criteria"] = {}, {}, {}
    for k in range(count):
        x = SPACING * (k % columns - 0.5 * (width - 1))
        y = SPACING * (k // columns - 0.5 * (depth - 1))
        start, goal = [x, y, 0.0], [x + STEP, y, 0.0]
        tree["vehicles"][f"sat{k + 1}"] = {"model": model, "start": start, "goal": goal}
    tree["table"]["size"] = [SPACING * width + 2.0 * RIM, SPACING * depth + 2.0 * RIM]
    tree["table"]["link"]["range_m"] = RANGE
    tree["deploy"]["law"], tree["duration_s"] = "vehicle", seconds
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "fleet.toml"
        path.write_text(tomli_w.dumps(tree), encoding="utf-8")
        return load(path)


def cost(experiment):
    """Processor time per vehicle and second of the flight [s]."""
    rig = make_twin(experiment)
    with steady_memory():  # as all flights are flown
        began = time.process_time()
        ending = rig.fly(NullObserver())
        spent = time.process_time() - began
    assert ending.fault is None, ending.fault
    assert not rig.touches
    return spent / (len(experiment.vehicles) * experiment.duration_s)


def main():
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--seconds", type=float, default=10.0, help="of the hundred")
    parser.add_argument("--rounds", type=int, default=3)
    options = parser.parse_args()
    # as many vehicle seconds for both: the best of short runs is better than that of long ones
    fleets = {count: fleet(count, 100 * options.seconds / count) for count in (10, 100)}
    cost(fleet(10, 1.0))
    best = dict.fromkeys(fleets, math.inf)
    for _ in range(options.rounds):
        for count, experiment in fleets.items():
            best[count] = min(best[count], cost(experiment))
    for count, spent in best.items():
        print(f"{count} vehicles: {1e3 * spent:.2f} ms per vehicle and second of flight")
    print(f"a hundred cost {best[100] / best[10]:.2f} times as much each")


if __name__ == "__main__":
    main()
