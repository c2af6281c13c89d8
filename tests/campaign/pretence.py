"""A crew that flies nothing; not in conftest.py, because workers look it up by its module."""

import os
from collections.abc import Sequence
from threading import Event

from testbed.campaign.row import FlownRun, Kept, Task
from testbed.config import Experiment, find, load


def pretend(base: str, batch: Sequence[Task]) -> list[FlownRun]:
    """Every third run fails.

    `deadly.<k>.` in the experiment's description kills run k's worker, `endless.<k>.` keeps it.
    """
    flown = []
    for k, overrides in batch:
        if f"deadly.{k}." in base:
            os._exit(1)
        if f"endless.{k}." in base:
            Event().wait()
        number = float(len(" ".join(overrides)) + k)
        outcome = "failed" if k % 3 == 0 else "passed"
        columns = {"goal_rms_m": 1e-3 * number, "gas_g": 100.0 - number, "contacts": k % 2}
        flown.append(FlownRun(k, outcome, "settle_s" * (k % 3 == 0), columns, {"settle_s": True}))
    return flown


def pretend_with_log(base: str, batch: Sequence[Task]) -> list[Kept]:
    return [Kept(run.k, {"log.mcap": b"log"}, run.columns) for run in pretend(base, batch)]


def otherwise_with_log(base: str, batch: Sequence[Task]) -> list[Kept]:
    """Run 0 uses more gas, run 3 raises, run 6 is the same."""
    runs = pretend_with_log(base, batch)
    more = {0: {"gas_g": 1e3}, 3: {}, 6: runs[-1].columns}
    return [Kept(run.k, run.files, more[run.k]) for run in runs]


def no_warm_up(base: str, batch: Sequence[Task]) -> None:
    """Nothing is compiled."""


def never_warm(base: str, batch: Sequence[Task]) -> None:
    """A law that never ends."""
    Event().wait()


def hold(base: str, overrides: Sequence[str]) -> Experiment:
    """What is flown is never looked at."""
    return load(find("hold"))


def of_another_version(base: str, batch: Sequence[Task]) -> list[FlownRun]:
    """As a worker that joins late with other code."""
    from testbed.campaign import engine

    engine.code_digest = lambda: "other"
    return pretend(base, batch)
