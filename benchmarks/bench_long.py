"""A long flight on the bench on a loaded machine: how close the watchdog came to its limit.

    python benchmarks/bench_long.py [EXPERIMENT] [KEY=VALUE ...] [--hogs N]

Prints how the flight ended, lateness, and for each board the longest time without a word from the
vehicle while it was armed. The watchdog trips at 150 ms; a frame is sent every 20 ms.
"""

import argparse
import sys
from contextlib import ExitStack

from load import loaded

from testbed.config import find, load
from testbed.realtime.scheduling import steady_memory
from testbed.rig.observers import NullObserver
from testbed.rig.twin import warm_up
from testbed.rig.wired.host import WireRig


def main():
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("experiment", nargs="?", default="zhang2023_table")
    parser.add_argument("overrides", nargs="*")
    parser.add_argument("--hogs", type=int, default=0)
    args = parser.parse_intermixed_args()
    experiment = load(find(args.experiment), args.overrides)
    warm_up(experiment)
    rig = WireRig(experiment, bench=True)
    with ExitStack() as stack:
        rig.on_start = lambda rig: stack.enter_context(loaded(args.hogs))
        with steady_memory():
            ending = rig.fly(NullObserver())
    wires = rig.wires()
    print(f"{experiment.name}, law on the {experiment.deploy.law}, {args.hogs} hogs: {ending}")
    print(
        f"lateness p99 {wires['lateness_p99_ms']:.1f} ms; longest silence of an armed board [ms]:"
    )
    if rig.results.report is not None:
        print("  " + ", ".join(f"{n} {ms:.0f}" for n, ms in rig.results.report.silence_ms.items()))
        print(f"  late edges {rig.results.report.late_edges}, contacts {len(rig.touches)}")
    return int(ending.fault is not None)


if __name__ == "__main__":
    sys.exit(main())
