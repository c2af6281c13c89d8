"""`testbed.fly_many`: any experiments, flown beside each other, as a table."""

import os
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
import tomli_w

from testbed.campaign.process_pool import fly_in_processes
from testbed.campaign.row import FlownRun
from testbed.campaign.worker import Order
from testbed.config import Experiment, dump
from testbed.run.arguments import check_count, check_experiment, check_positive, list_of
from testbed.run.table import Table

UNITS = {"_m": "m", "_s": "s", "_deg": "deg", "_ns": "N s", "_g": "g", "_n": "N"}
LIMIT_S = 3600.0


def fly_many(
    experiments: Iterable[Experiment], jobs: int | None = None, limit_s: float = LIMIT_S
) -> Table:
    """Fly experiments on the twin, several at the same time, without logs.

    Each flight is the one that `testbed.fly` flies alone, to the last bit. A law that raises,
    exits, crashes or hangs spoils its own row only: a call that takes longer than
    `deploy.law_limit_s` is a fault, and one that cannot be interrupted is given up after `limit_s`.

    Args:
        experiments: from `testbed.load`; each may have other vehicles, laws and seeds.
        jobs: processes that fly at the same time; None: one per core.
        limit_s: computing time after which a flight is given up [s].

    Returns:
        One row per experiment, in their order: `experiment`, `seed`, `outcome` ("passed",
        "failed", "fault", "error", "refused", "lost"), `reason`, and the metrics. `settle_s` is
        the worst vehicle's, `sat1.settle_s` one vehicle's. NaN where a number does not apply.

    Raises:
        TestbedError: an argument is not possible.
    """
    where = "testbed.fly_many"
    flown = list_of(where, experiments, "a list of experiments, from testbed.load")
    if jobs is not None:
        check_count(f"{where}, jobs", jobs, "a number of processes, 1 or more")
    check_positive(f"{where}, limit_s", limit_s, "a computing time in seconds, above 0")
    for one in flown:
        check_experiment(where, one)
    orders = [Order(k, tomli_w.dumps(dump(one))) for k, one in enumerate(flown)]
    runs = fly_in_processes(orders, jobs or os.cpu_count() or 1, limit_s)
    columns = {
        "experiment": np.array([one.name for one in flown]),
        "seed": np.array([one.seed for one in flown], dtype=np.int64),
    }
    return table_of(columns, runs)


def table_of(columns: dict[str, Any], runs: Sequence[FlownRun]) -> Table:
    """The columns, and after them outcome, reason and metrics of each run.

    A value that was asked for keeps its name: the metric `duration_s` is `flown_s` then.
    """
    asked, columns = columns.keys(), dict(columns)
    columns["outcome"] = np.array([run.outcome for run in runs])
    columns["reason"] = np.array([run.reason for run in runs])
    for name in dict.fromkeys(name for run in runs for name in run.columns):
        flown = "flown_s" if name in asked else name
        columns[flown] = np.array([_number(run.columns.get(name)) for run in runs])
    return Table(columns, {name: unit for name in columns if (unit := _unit(name))})


def _number(value: float | int | None) -> float:
    return float("nan") if value is None else float(value)


def _unit(name: str) -> str:
    return next((unit for end, unit in UNITS.items() if name.endswith(end)), "")
