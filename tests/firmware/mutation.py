"""Put every fault of `mutants` into the core and see whether a test notices: `make mutants`.

    python tests/firmware/mutation.py             every fault; writes survivors.toml
    python tests/firmware/mutation.py --survivors only those that survived before; corrects it
    python tests/firmware/mutation.py --every 100 a sample; writes nothing

The tests are collected once; then each fault gets a process of its own with a limit of CPU time,
for some corrupt its memory and some never return. What killed last is tried first. A survivor
without an explanation in survivors.toml makes the run fail.
"""

import argparse
import json
import os
import shutil
import signal
import sys
import tempfile
import tomllib
import zlib
from collections import Counter, deque
from pathlib import Path
from typing import NamedTuple

import pytest
from mutants import Mutant, all_mutants, library, same_machine_code, unchanged

HERE = Path(__file__).parent
TESTS = tuple(HERE / f"test_{name}.py" for name in ("behaviour", "line", "finer_points"))
LIMIT_S = 0.7  # of CPU for one test: several times what the longest takes

LEAST = 90  # of faults noticed [%]
RECORD = HERE / "survivors.toml"
NAMES = ("file", "function", "was", "now", "nth")
OUTCOMES = ("survived", "killed", "same_code", "not_built", "hung")
HUNG = 4


class Trial(NamedTuple):
    """A fault under test."""

    fault: Mutant
    room: Path


class Campaign:
    """A pytest plugin that runs the collected tests once for each fault."""

    def __init__(self, faults: tuple[Mutant, ...], processes: int) -> None:
        self.faults, self.processes = faults, processes
        self.outcome: dict[Mutant, str] = {}
        self.healthy = False

    @pytest.hookimpl
    def pytest_runtestloop(self, session: pytest.Session) -> bool:
        """Instead of pytest's own loop."""
        order = deque(item for item in session.items if "new_host" in item.fixturenames)
        self.healthy = self._first_failure(session, order) is None
        if not self.healthy:
            return True
        with tempfile.TemporaryDirectory() as folder:
            objects = unchanged(Path(folder))
            running: dict[int, Trial] = {}
            waiting = iter(self.faults)
            while running or len(self.outcome) < len(self.faults):
                fault = next(waiting, None) if len(running) < self.processes else None
                if fault is None:
                    child, status = os.wait()
                    self._note(running.pop(child), status, order)
                    continue
                room = Path(tempfile.mkdtemp(dir=folder))
                child = os.fork()
                if child == 0:
                    os._exit(self._try(session, order, fault, objects, room))
                running[child] = Trial(fault, room)
        return True

    def _note(self, trial: Trial, status: int, order: deque) -> None:
        died = os.WTERMSIG(status) if os.WIFSIGNALED(status) else None
        code = HUNG if died == signal.SIGPROF else 1 if died else os.WEXITSTATUS(status)
        self.outcome[trial.fault] = OUTCOMES[code]
        if (trial.room / "killer").exists():
            name = (trial.room / "killer").read_text()
            killer = next(item for item in order if item.nodeid == name)
            order.remove(killer)
            order.appendleft(killer)
        shutil.rmtree(trial.room)
        if len(self.outcome) % 50 == 0:
            print(len(self.outcome), "of", len(self.faults), flush=True)  # noqa: T201

    def _try(
        self, session: pytest.Session, order: deque, fault: Mutant, objects: dict, room: Path
    ) -> int:
        """In a process of its own; its exit status is an index of OUTCOMES."""
        nowhere = os.open(os.devnull, os.O_RDWR)
        for stream in (0, 1, 2):
            os.dup2(nowhere, stream)
        path = library(fault, objects, room)
        if path is None:
            return 3
        os.environ["ABT_LIBRARY"] = str(path)
        killer = self._first_failure(session, order)
        if killer is not None:
            (room / "killer").write_text(killer.nodeid)
            return 1
        return 2 if same_machine_code(fault, room) else 0

    @staticmethod
    def _first_failure(session: pytest.Session, order: deque) -> pytest.Item | None:
        failed = None
        for item in tuple(order):
            signal.setitimer(signal.ITIMER_PROF, LIMIT_S)  # its signal ends the process
            item.config.hook.pytest_runtest_protocol(item=item, nextitem=None)
            if session.testsfailed:
                failed = item
                break
        signal.setitimer(signal.ITIMER_PROF, 0)
        return failed


def outcomes(faults: tuple[Mutant, ...], processes: int) -> dict[Mutant, str]:
    """What became of each fault.

    Raises:
        RuntimeError: the tests fail without any fault.
    """
    campaign = Campaign(faults, processes)
    options = [
        "-o",
        "addopts=",
        "-x",
        "-p",
        "no:cacheprovider",
        "-p",
        "no:xdist",
        "-p",
        "no:terminal",
        "-p",
        "no:faulthandler",
    ]
    pytest.main([*options, *map(str, TESTS)], plugins=[campaign])
    if not campaign.healthy:
        raise RuntimeError("the tests fail on the core as it is: mend that first")
    return campaign.outcome


def record(everything: dict[str, int], survivors: list[dict]) -> str:
    """survivors.toml: figures, and who survived why."""
    lines = [
        "# Written by `make mutants` but for `why`, which is for people to write. The score counts",
        "# every survivor against the tests, explained or not.",
        "",
        *(f"{name} = {value}" for name, value in everything.items()),
        f"score_percent = {score(everything):.1f}",
        f'of_core = "{state_of_the_core()}"',
    ]
    for survivor in survivors:
        lines += ["", "[[survivor]]"]
        lines += [f"{name} = {json.dumps(value)}" for name, value in survivor.items()]
    return "\n".join(lines) + "\n"


def score(everything: dict[str, int]) -> float:
    """Share of the faults noticed, of those that make another program [%]."""
    faults = sum(everything.values()) - everything["same_code"] - everything["not_built"]
    return 100.0 * (everything["killed"] + everything["hung"]) / faults


def state_of_the_core() -> str:
    """Changes with every line of code that can hold a fault; not with comments."""
    return f"{zlib.crc32(repr([fault.name for fault in all_mutants()]).encode()):08x}"


def main() -> str | None:
    """Why the run fails, if it does."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--every", type=int, default=1)
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--survivors", action="store_true")
    options = parser.parse_args()
    before = tomllib.loads(RECORD.read_text()) if RECORD.exists() else {"survivor": []}
    reasons = {tuple(s[name] for name in NAMES): s["why"] for s in before["survivor"]}
    faults = all_mutants()[:: options.every]
    if options.survivors:
        faults = tuple(fault for fault in faults if fault.name in reasons)
    found = outcomes(faults, options.processes)
    counts = {name: Counter(found.values())[name] for name in OUTCOMES}
    survivors = [fault for fault, what in found.items() if what == "survived"]
    if options.survivors:
        for name in OUTCOMES:
            counts[name] += before[name] if name != "survived" else 0
    if options.every == 1:
        rows = [
            dict(zip(NAMES, fault.name, strict=True)) | {"why": reasons.get(fault.name, "")}
            for fault in survivors
        ]
        RECORD.write_text(record(counts, rows))
    unexplained = [fault.name for fault in survivors if not reasons.get(fault.name)]
    print(counts, f"{score(counts):.1f} %")  # noqa: T201
    if unexplained:
        return "no test notices, and nobody says why:\n" + "\n".join(map(str, unexplained))
    if options.every == 1 and score(counts) < LEAST:
        return f"the tests notice fewer than {LEAST} %"
    return None


if __name__ == "__main__":
    sys.exit(main())
