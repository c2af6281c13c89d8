"""The log of a run: its size, its share of the flight's time, how fast its columns open.

    python benchmarks/log.py [--experiment zhang2023_table] [--rounds 5]

The same flight, with a log on disk and without, in turn in one process: the difference is what the
log costs the flight. The writer is a process of its own; its CPU time stands beside it. Columns are
all topics of records as numpy arrays, read from the file. Exit code 1 if a limit of `LIMITS` is not
met.
"""

import argparse
import resource
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

from testbed.config import Experiment, find, load
from testbed.logs.columns import Columns
from testbed.logs.log_reader import LogReader
from testbed.logs.recorder import FAST_SPAN_NS, Recorder
from testbed.metrics.run_metrics import ReferenceLog
from testbed.realtime.scheduling import steady_memory
from testbed.rig.observers import MetricsObserver
from testbed.rig.twin import make_twin, warm_up
from testbed.run.fly import FlightLog, FlightScreen, names_of, tick_of
from testbed.run.markers import scene_of

LIMITS = {"megabytes": 3.0, "share of the flight": 0.10, "columns [s]": 0.1}


def flown(experiment: Experiment, path: Path | None) -> tuple[float, float]:
    """CPU time of this process for a flight, and of the writer [s]."""
    rig = make_twin(experiment)
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    if path is None:
        began = time.process_time()
        with steady_memory():
            rig.fly(MetricsObserver(experiment.vehicles))
        return time.process_time() - began, 0.0
    recorder = Recorder(
        path,
        names=names_of(experiment),
        span_ns=FAST_SPAN_NS,
        tick_ns=tick_of(experiment),
        scene=scene_of(experiment),
    )
    references = {name: ReferenceLog() for name in experiment.vehicles}
    with recorder:
        log = FlightLog(rig, references, recorder, FlightScreen())
        began = time.process_time()
        with steady_memory():
            rig.fly(log)
        used = time.process_time() - began
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def opened(path: Path) -> float:
    """CPU time to open all columns of a log [s]."""
    began = time.process_time()
    Columns(LogReader(path))
    return time.process_time() - began


def main() -> int:
    """1 if a limit is not met."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--experiment", default="zhang2023_table")
    parser.add_argument("--rounds", type=int, default=5)
    args = parser.parse_args()
    experiment = load(find(args.experiment), ["criteria={}"])
    warm_up(experiment)
    with tempfile.TemporaryDirectory() as folder:
        flights = []
        for k in range(args.rounds):
            path = Path(folder) / f"{k}.mcap"
            flights.append((*flown(experiment, path), flown(experiment, None)[0]))
        size = path.stat().st_size / 1e6
        columns = min(opened(path) for _ in range(args.rounds))
        counts: Counter[str] = Counter()
        for row in LogReader(path).read():
            counts[row.topic.rpartition("/")[2]] += 1
    logged, writer, bare = (min(one[k] for one in flights) for k in range(3))
    share = (logged - bare) / logged
    found = {"megabytes": size, "share of the flight": share, "columns [s]": columns}
    print(f"{experiment.name}, {experiment.duration_s:g} s, {len(experiment.vehicles)} vehicles")
    print(f"  CPU: flight {bare:.2f} s, with its log {logged:.2f} s; its writer {writer:.2f} s")
    print("  messages: " + ", ".join(f"{name} {count}" for name, count in sorted(counts.items())))
    for name, value in found.items():
        met = value <= LIMITS[name]
        print(f"  {name:20} {value:8.3f}  limit {LIMITS[name]:g}{'' if met else '  NOT MET'}")
    return 0 if all(value <= LIMITS[name] for name, value in found.items()) else 1


if __name__ == "__main__":
    sys.exit(main())
