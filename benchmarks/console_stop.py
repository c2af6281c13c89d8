"""Time from STOP in a browser to closed valves on the bench, by the boards' stamps.

    python benchmarks/console_stop.py [--count 5] [--case plain|hang|suspend] [--load 0]

Each count is a flight of real processes and real firmware with the page open in Chromium. The first
press is given while the vehicle is on its way: it brakes. The second comes 0.65 s later, in
the middle of the brake: every valve shuts at once. What counts for the first is the end of the
vehicle's last flying period, or a fault that makes it brake sooner, such as a silent host; for
the second the last edge that its board has reported. Presses fall on all parts of the jet period.
`hang`: the law on the host hangs and holds Python's lock. `suspend`: the whole host is suspended
(SIGSTOP) 0.2 s before the first press. `--load N` keeps N processes busy meanwhile.
"""

import argparse
import json
import os
import select
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from threading import Event

import msgspec
import numpy as np

from testbed.config import dump, find, load
from testbed.core.codes import Response
from testbed.files import write_atomic
from testbed.net.commands import Ended
from testbed.rig.wired.host import WireRig
from testbed.rig.wired.table_report import TableReport
from testbed.run.fly import fly_and_judge
from testbed.run.folder import write_config

sys.path.insert(0, str(Path(__file__).parents[1] / "docs" / "pictures"))
from browser import Browser
from load import loaded

FAST = [  # 0.25 m/s from 6 s on, so that the brake takes some seconds
    "vehicles.sat1.start=[-2.3,0.0,0.0]", "vehicles.sat1.goal=[2.3,0.0,0.0]",
    "controller.bandwidth=1.0", "criteria={}", "duration_s=40",
]  # fmt: skip
BETWEEN_S = 0.65  # two presses; sooner they would count as one
SUSPENDED_S = 0.2  # before the first press
PERIOD_S, SPREAD = 0.1, 0.618  # jet period, and the share of it between the presses of two flights
PATIENCE_S = 300.0
LOST = 10  # flights that may be lost


class LostError(Exception):
    """This machine was too busy for a flight; it does not count."""


def pause(seconds: float) -> None:
    Event().wait(seconds)


def host(folder: Path, words: list[str], at: float, hangs: bool) -> None:
    """Fly on the bench, as `testbed run --rig bench` does, and keep what the boards report."""
    experiment = load(find("hold"), words)
    write_config(folder, dump(experiment), "benchmark")

    def make(one):
        rig = WireRig(one, bench=True, log=folder, keep=folder / "report.json")

        def started(rig):
            start = json.dumps([rig.results.epoch_ns, os.getpid()])
            write_atomic(folder / "start.json", start.encode())

        rig.on_start = started
        return rig

    if hangs:
        hang_after(at - SUSPENDED_S)
    fly_and_judge(experiment, folder, make=make)
    (folder / "done").write_text("")


def hang_after(t: float) -> None:
    """After a time of the run a call of the law never returns and holds Python's lock."""
    import ctypes

    from testbed.flight.guidance import Guidance

    step = Guidance.step

    def hang(self, now, *more):
        if now >= t:
            ctypes.PyDLL(None).sleep(60)
        return step(self, now, *more)

    Guidance.step = hang


def until(what, look, patience=PATIENCE_S):
    end = time.monotonic() + patience
    while time.monotonic() < end:
        if found := look():
            return found
        pause(0.02)
    raise TimeoutError(what)


def page_of(folder: Path):
    """The page's process, and its address."""
    page = subprocess.Popen(
        [sys.executable, "-m", "testbed.console.process", str(folder), "127.0.0.1", "0"],
        stderr=subprocess.PIPE,
    )
    if not select.select([page.stderr], [], [], PATIENCE_S)[0]:
        raise TimeoutError("the page does not start")
    return page, page.stderr.readline().decode().split()[-1]


def press(browser) -> int:
    """Click the button as a mouse does; the time before it [ns]."""
    x, y = browser.value(
        "(r => [r.x + r.width / 2, r.y + r.height / 2])"
        "(document.getElementById('stop').getBoundingClientRect())"
    )
    at = time.monotonic_ns()
    for kind in ("mousePressed", "mouseReleased"):
        browser.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", clickCount=1)
    return at


def one_flight(
    browser, folder: Path, words: list[str], case: str, at: float
) -> tuple[list, list, int]:
    """Delays of the first and the second press [ms], and how many boards were busy."""
    folder.mkdir()
    hangs = ["--hangs"] if case == "hang" else []
    pilot = subprocess.Popen(
        [sys.executable, __file__, "--host", str(folder), "--at", str(at), *hangs, *words],
        stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
    )  # fmt: skip
    page, url = page_of(folder)
    try:
        browser.open(url)
        button = "document.getElementById('ways').textContent"
        until("a button", lambda: pilot.poll() is not None
              or "to the host" in (browser.value(button) or ""))  # fmt: skip
        start = folder / "start.json"
        until("a start", lambda: start.exists() or pilot.poll() is not None)
        if pilot.poll() is not None:
            raise LostError("it ended before the page was there")
        epoch, pid = json.loads(start.read_text())
        due = epoch + round(1e9 * at)
        if case == "suspend":
            pause(max(0.0, 1e-9 * (due - time.monotonic_ns()) - SUSPENDED_S))
            os.kill(pid, signal.SIGSTOP)
        pause(max(0.0, 1e-9 * (due - time.monotonic_ns())))
        first = press(browser)
        pause(BETWEEN_S)
        answer = "document.getElementById('told').textContent"
        heard = "Number(document.getElementById('told').dataset.heard)"
        told, way = browser.value(answer), [browser.value(heard)]  # None: no answer yet
        second = press(browser)
        pause(2.0)
        told += f"; then {browser.value(answer)}"
        way.append(browser.value(heard))
        if case == "suspend":
            os.kill(pid, signal.SIGCONT)
        if case == "hang":
            pause(2.0)
            os.kill(pid, signal.SIGKILL)
        pilot.wait(PATIENCE_S)
    finally:
        page.terminate()
        page.wait()
        if pilot.poll() is None:
            pilot.kill()
            pilot.wait()
    report = until("a report", lambda: (folder / "report.json").exists() and msgspec.json.decode(
        (folder / "report.json").read_bytes(), type=TableReport), 30.0)  # fmt: skip
    braked, shut, faults = [], [], ""
    for name, edges in report.edges.items():
        ended = msgspec.json.decode((folder / f"{name}.json").read_bytes(), type=Ended)
        begun = min([ended.t, *(t for r, t in ended.responses.items() if r >= Response.BRAKE)])
        braked.append(1e-6 * (epoch + 1e9 * begun - first))
        if braked[-1] < 0.0:
            raise LostError(f"{name} brakes before the press: {ended.fault}")
        faults += f"; {ended.fault.words}" if ended.fault else ""
        late = [1e-3 * (at_us - second / 1e3) for at_us, _ in edges]
        shut.append(max(0.0, *late))
        if edges[-1][1]:
            raise RuntimeError(f"{name}: a valve is open at the end")
    busy = sum(any(0 < second / 1e3 - at < 3e5 for at, _ in e) for e in report.edges.values())
    pairs = zip(way, (first, second), strict=True)
    by_browser = [f"{1e-6 * (at - press):.0f} ms" if at else "no answer" for at, press in pairs]
    print(f"  {told}{faults}; at the page's process after {', '.join(by_browser)}", flush=True)
    return braked, shut, busy


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--count", type=int, default=5, help="flights; two presses each")
    parser.add_argument("--case", choices=["plain", "hang", "suspend"], default="plain")
    parser.add_argument("--at", type=float, default=6.0, help="time of the first press [s]")
    parser.add_argument("--load", type=int, default=0, help="busy processes")
    parser.add_argument("--host", type=Path, help=argparse.SUPPRESS)
    parser.add_argument("--hangs", action="store_true", help=argparse.SUPPRESS)
    options, words = parser.parse_known_args()
    words = words or FAST
    if options.host is not None:
        host(options.host, words, options.at, options.hangs)
        return
    print(f"load average {os.getloadavg()[0]:.1f}", flush=True)
    braked, shut, beside = [], [], 0
    with (
        loaded(options.load),
        tempfile.TemporaryDirectory() as folder,
        Browser(1366, 768) as browser,
    ):
        k, lost = 0, 0
        while k < options.count:
            try:
                at = options.at + PERIOD_S * (SPREAD * k % 1.0)
                one = one_flight(browser, Path(folder) / f"{k}_{lost}", words, options.case, at)
            except LostError as error:
                lost += 1
                print(f"not counted: {error}", flush=True)
                if lost > LOST:
                    raise
                continue
            k += 1
            braked += one[0]
            shut += one[1]
            beside += one[2]
            print(f"{k}: brake {max(one[0]):.0f} ms, shut {max(one[1]):.0f} ms", flush=True)
    print(
        f"{options.case}, {options.count} flights, load {options.load}, {len(shut)} boards,"
        f" valves of {beside} in use within 0.3 s before the second press"
    )
    for words_, values in (("first press to brake", braked), ("second press to shut", shut)):
        p50, p95 = np.percentile(values, [50, 95])
        print(f"{words_:22s} p50 {p50:5.0f} ms, p95 {p95:5.0f} ms, worst {max(values):5.0f} ms")


if __name__ == "__main__":
    main()
