"""`testbed.sweep`: one experiment with many values and seeds, as a table."""

import subprocess
import sys
from collections.abc import Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from itertools import product
from queue import SimpleQueue
from typing import Any

import msgspec
import numpy as np
import tomli_w

from testbed.campaign.row import FlownRun, Task
from testbed.campaign.trial import fly, read
from testbed.config import Experiment, dump
from testbed.core.error import TestbedError
from testbed.run.experiment import toml
from testbed.run.table import Table

UNITS = {"_m": "m", "_s": "s", "_deg": "deg", "_ns": "N s", "_g": "g", "_n": "N"}


class SweepError(TestbedError):
    """A sweep could not be flown."""


def sweep(
    experiment: Experiment,
    over: Mapping[str, Iterable[Any]] | None = None,
    seeds: Iterable[int] = range(1),
    jobs: int = 1,
) -> Table:
    """Fly an experiment with every combination of values, on every seed, without logs.

    Args:
        experiment: from `testbed.load`.
        over: values by dotted key: `{"controller.k": [0.2, 0.3]}`.
        seeds: each combination flies with each of these.
        jobs: processes that fly at the same time.

    Returns:
        One row per run, in the order of combinations and seeds: the values, `seed`, `outcome`
        ("passed", "failed", "fault", "error", "refused"), `reason`, and the metrics. `settle_s` is
        the worst vehicle's, `sat1.settle_s` one vehicle's. NaN where a number does not apply.

    Raises:
        TestbedError: a key or value is not possible, or a process died.
    """
    axes = {key: list(values) for key, values in (over or {}).items()}
    rows = [(values, seed) for values in product(*axes.values()) for seed in seeds]
    base = tomli_w.dumps(dump(experiment))
    tasks: list[Task] = [
        (k, (*(f"{key}={toml(v)}" for key, v in zip(axes, values, strict=True)), f"seed={seed}"))
        for k, (values, seed) in enumerate(rows)
    ]
    for values in dict.fromkeys(task[1][:-1] for task in tasks):
        read(base, values)  # a wrong key is refused before the first flight
    runs = [fly(base, *t) for t in tasks] if jobs <= 1 else _fly_beside(base, tasks, jobs)
    return _table(axes, rows, runs)


def _fly_beside(base: str, tasks: Sequence[Task], jobs: int) -> list[FlownRun]:
    """Fly in worker processes; each takes the next task when it is done."""
    waiting: SimpleQueue[Task] = SimpleQueue()
    for task in tasks:
        waiting.put(task)
    runs: dict[int, FlownRun] = {}
    workers = [
        subprocess.Popen(
            [sys.executable, "-m", "testbed.campaign.worker"],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE,
        )
        for _ in range(min(jobs, len(tasks)))
    ]  # fmt: skip

    def feed(worker: "subprocess.Popen[bytes]") -> None:
        assert worker.stdin is not None
        assert worker.stdout is not None
        worker.stdin.write(msgspec.json.encode(base) + b"\n")
        while not waiting.empty():
            task = waiting.get()
            worker.stdin.write(msgspec.json.encode(task) + b"\n")
            worker.stdin.flush()
            line = worker.stdout.readline()
            if not line:
                raise SweepError(
                    where=f"run {task[0]} ({', '.join(task[1])})", expected="a result",
                    found="the process died during the flight",
                )  # fmt: skip
            runs[task[0]] = msgspec.json.decode(line, type=FlownRun)

    try:
        with ThreadPoolExecutor(len(workers)) as threads:
            try:
                for done in [threads.submit(feed, worker) for worker in workers]:
                    done.result()
            except BaseException:  # a worker died, or Ctrl-C: the others get no more tasks
                while not waiting.empty():
                    waiting.get()
                for worker in workers:
                    worker.kill()
                raise
    finally:
        for worker in workers:
            worker.kill()
            worker.communicate()
    return [runs[k] for k in range(len(tasks))]


def _table(
    axes: Mapping[str, Sequence[Any]], rows: Sequence[tuple[tuple[Any, ...], int]],
    runs: Sequence[FlownRun],
) -> Table:  # fmt: skip
    columns: dict[str, Any] = {
        key: _column([values[k] for values, _ in rows]) for k, key in enumerate(axes)
    }
    columns["seed"] = np.array([seed for _, seed in rows], dtype=np.int64)
    columns["outcome"] = np.array([run.outcome for run in runs])
    columns["reason"] = np.array([run.reason for run in runs])
    for name in dict.fromkeys(name for run in runs for name in run.columns):
        columns[name] = np.array([_number(run.columns.get(name)) for run in runs])
    return Table(columns, {name: unit for name in columns if (unit := _unit(name))})


def _column(values: list[Any]) -> np.ndarray:
    plain = all(isinstance(value, int | float | str | bool) for value in values)
    if plain and len({type(value) for value in values}) <= 1:
        return np.array(values)
    column = np.empty(len(values), dtype=object)
    column[:] = values
    return column


def _number(value: float | int | None) -> float:
    return float("nan") if value is None else float(value)


def _unit(name: str) -> str:
    return next((unit for end, unit in UNITS.items() if name.endswith(end)), "")
