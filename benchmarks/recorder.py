"""The log of record at six vehicles and 100 Hz: CPU time, file size, gaps, what a SIGKILL costs.

    python benchmarks/recorder.py [SECONDS OF THE RUN, 600] [KILLS, 20]

The messages are those of a flight on the twin, with their stamps moved. They are written in real
time, so the log writer's CPU time divided by the time is its share of a core. SIGKILL hits both
writer and log writer; lost is what had been handed over and is not in the file.
"""

import os
import resource
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from threading import Event

import msgspec
import numpy as np

from testbed.core.types import HostTick, Tick
from testbed.logs.log_reader import LogReader
from testbed.logs.recorder import Recorder
from testbed.logs.truth import Motion, Truth

VEHICLES, RATE_HZ = 6, 100.0


class Keeper:
    def __init__(self) -> None:
        self.ticks: list = []
        self.hosts: list = []

    def vehicle(self, name, tick):
        self.ticks.append(tick)

    def host(self, name, tick):
        self.hosts.append(tick)

    def done(self, t):
        pass


Messages = tuple[list[Tick], list[HostTick]]


def messages(path: Path, seconds: float) -> Messages:
    """Messages of a flight on the twin, stored in a file so that it is flown once."""
    if not path.exists():
        from testbed.config import find, load
        from testbed.rig.twin import make_twin

        keeper = Keeper()
        make_twin(load(find("hold"), [f"duration_s={seconds}"])).fly(keeper)
        path.write_bytes(msgspec.msgpack.encode((keeper.ticks, keeper.hosts)))
    return msgspec.msgpack.decode(path.read_bytes(), type=Messages)


def write(path: Path, seconds: float, announce: bool) -> float:
    """Write the messages in real time; returns the CPU time of this process [s]."""
    (ticks, hosts), pause = messages(path.with_name("messages"), 12.0), Event()
    motions = {f"sat{n}": Motion(1.0, 2.0, 3.0, 0.1, 0.2, 0.3) for n in range(VEHICLES)}
    with Recorder(path) as recorder:
        if announce:
            print(recorder._writer.pid, flush=True)
        began, used = time.monotonic(), time.process_time()
        for k in range(round(seconds * RATE_HZ)):
            t = k / RATE_HZ
            pause.wait(max(0.0, began + t - time.monotonic()))
            for n in range(VEHICLES):
                recorder.write(f"/sat{n}/tick", t, ticks[k % len(ticks)])
                recorder.write(f"/sat{n}/host", t, hosts[k % len(hosts)])
            recorder.write("/truth", t, Truth(t, motions))
            recorder.mark(t)
            if announce:
                print(k, flush=True)
        used = time.process_time() - used
    return used


def lost_by_kill(path: Path, instant: float) -> float:
    """Kill writer and log writer; what was handed over and is not there [s]."""
    flight = subprocess.Popen(
        [sys.executable, __file__, "--announce", str(path)], stdout=subprocess.PIPE
    )
    log_writer = int(flight.stdout.readline())
    flight.stdout.readline()  # the first tick is handed over
    Event().wait(instant)
    os.kill(flight.pid, signal.SIGKILL)
    os.kill(log_writer, signal.SIGKILL)
    rest, _ = flight.communicate()
    handed_over = int(rest.split()[-1]) / RATE_HZ if rest.split() else 0.0
    stamps = [row.stamp * 1e-9 for row in LogReader(path).read()]
    return max(0.0, handed_over - stamps[-1]) if stamps else handed_over


def main() -> None:
    if sys.argv[1:2] == ["--announce"]:
        write(Path(sys.argv[2]), 60.0, announce=True)
        return
    seconds = float(sys.argv[1]) if len(sys.argv) > 1 else 600.0
    kills = int(sys.argv[2]) if len(sys.argv) > 2 else 20
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "log.mcap"
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        own = write(path, seconds, announce=False)
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        log_writer = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
        stamps: dict[str, list[int]] = {}
        for row in LogReader(path).read():
            stamps.setdefault(row.topic, []).append(row.stamp)
        gaps = sum(int(np.sum(np.diff(s) != round(1e9 / RATE_HZ))) for s in stamps.values())
        count = sum(len(s) for s in stamps.values())
        print(f"{VEHICLES} vehicles at {RATE_HZ:g} Hz for {seconds:g} s: {count} messages")
        print(f"  log writer {100 * log_writer / seconds:.1f} % of a core")
        print(f"  flight     {100 * own / seconds:.1f} % of a core, encoding and handing over")
        print(f"  file       {path.stat().st_size / 1e6:.1f} MB")
        print(f"  gaps       {gaps}")
        instants = np.random.default_rng(20).uniform(0.1, 2.0, kills).tolist()
        losses = [lost_by_kill(Path(folder) / f"{k}.mcap", s) for k, s in enumerate(instants)]
        if losses:
            print(
                f"  {kills} SIGKILLs lost at most {max(losses):.2f} s, mean {np.mean(losses):.2f} s"
            )


if __name__ == "__main__":
    main()
