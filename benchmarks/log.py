"""The log of a run: its size, its share of the flight's time, how fast its columns open.

    python benchmarks/log.py [--experiment zhang2023_table] [--rounds 9]

The share is the CPU time of the flight's thread inside the log's calls, of the process's in the
same flight; the median of some flights counts. Both are measured in one flight because a busy
machine changes its speed from flight to flight by more than the log costs. The same flight without
a log stands beside it, and the writer's CPU time: that is a process of its own. Columns are all
topics of records as numpy arrays, read from the file. Exit code 1 if a limit of `LIMITS` is not
met.
"""

import argparse
import resource
import sys
import tempfile
from collections import Counter
from pathlib import Path
from statistics import median
from time import process_time, thread_time

from testbed.config import Experiment, find, load
from testbed.flight.flown_span import FlownRows, FlownSpan
from testbed.flight.flown_tick import AnyHostTick, AnyTick
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


class TimedReferences(ReferenceLog):
    """What the metrics need, also without a log: its time is not the log's."""

    seconds = 0.0  # of all of them

    def note(self, tick: AnyTick) -> None:
        before, began = TimedReferences.seconds, thread_time()
        super().note(tick)  # may call note_rows
        TimedReferences.seconds = before + thread_time() - began

    def note_rows(self, rows: FlownRows) -> None:
        began = thread_time()
        super().note_rows(rows)
        TimedReferences.seconds += thread_time() - began


class TimedLog(FlightLog):
    """Adds up the CPU time of this thread in its calls."""

    seconds = 0.0

    def vehicle(self, name: str, tick: AnyTick) -> None:
        began = thread_time()
        super().vehicle(name, tick)
        self.seconds += thread_time() - began

    def host(self, name: str, tick: AnyHostTick) -> None:
        began = thread_time()
        super().host(name, tick)
        self.seconds += thread_time() - began

    def ticks(self, span: FlownSpan) -> None:
        began = thread_time()
        super().ticks(span)
        self.seconds += thread_time() - began

    def done(self, t: float) -> None:
        began = thread_time()
        super().done(t)
        self.seconds += thread_time() - began


def flown(experiment: Experiment) -> float:
    """CPU time of a flight without a log [s]."""
    rig = make_twin(experiment)
    began = process_time()
    with steady_memory():
        rig.fly(MetricsObserver(experiment.vehicles))
    return process_time() - began


def logged(experiment: Experiment, path: Path) -> tuple[float, float, float]:
    """CPU time of a flight with its log, of this in the log's calls, and of the writer [s]."""
    rig = make_twin(experiment)
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    recorder = Recorder(
        path,
        names=names_of(experiment),
        span_ns=FAST_SPAN_NS,
        tick_ns=tick_of(experiment),
        scene=scene_of(experiment),
    )
    with recorder:
        references = {name: TimedReferences() for name in experiment.vehicles}
        log = TimedLog(rig, references, recorder, FlightScreen())
        TimedReferences.seconds = 0.0
        recorder.wait_for_writer()
        began = process_time()
        with steady_memory():
            rig.fly(log)
        flown_by = thread_time()
    inside = log.seconds - TimedReferences.seconds + thread_time() - flown_by  # the last rows
    used = process_time() - began
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    writer = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return used, inside, writer


def opened(path: Path) -> float:
    """CPU time to open all columns of a log [s]."""
    began = process_time()
    Columns(LogReader(path))
    return process_time() - began


def main() -> int:
    """1 if a limit is not met."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--experiment", default="zhang2023_table")
    parser.add_argument("--rounds", type=int, default=9)
    args = parser.parse_args()
    experiment = load(find(args.experiment), ["criteria={}"])
    warm_up(experiment)
    with tempfile.TemporaryDirectory() as folder:
        flights, bare = [], []
        for k in range(args.rounds):
            path = Path(folder) / f"{k}.mcap"
            flights.append(logged(experiment, path))
            bare.append(flown(experiment))
        size = path.stat().st_size / 1e6
        columns = min(opened(path) for _ in range(args.rounds))
        counts: Counter[str] = Counter()
        for row in LogReader(path).read():
            counts[row.topic.rpartition("/")[2]] += 1
    share = median(inside / used for used, inside, _ in flights)
    used, inside, writer = (min(one[k] for one in flights) for k in range(3))
    found = {"megabytes": size, "share of the flight": share, "columns [s]": columns}
    print(f"{experiment.name}, {experiment.duration_s:g} s, {len(experiment.vehicles)} vehicles")
    print(
        f"  CPU, least of {args.rounds}: flight with its log {used:.3f} s, of these the log"
        f" {inside:.3f} s; without a log {min(bare):.3f} s; the writer's process {writer:.2f} s"
    )
    print("  messages: " + ", ".join(f"{name} {count}" for name, count in sorted(counts.items())))
    for name, value in found.items():
        met = value <= LIMITS[name]
        print(f"  {name:20} {value:8.3f}  limit {LIMITS[name]:g}{'' if met else '  NOT MET'}")
    return 0 if all(value <= LIMITS[name] for name, value in found.items()) else 1


if __name__ == "__main__":
    sys.exit(main())
