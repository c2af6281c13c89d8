"""Campaign files to spoil, and a crew that flies nothing."""

import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import pytest
import tomli_w

from testbed.campaign.flight import Crew
from testbed.campaign.row import Flown, Kept, Task
from testbed.config import Experiment, find, load


def pretend(base: str, batch: Sequence[Task]) -> list[Flown]:
    """Every third run fails; `deadly.<k>` in the experiment's description kills run k's worker."""
    flown = []
    for k, overrides in batch:
        if f"deadly.{k}." in base:
            os._exit(1)
        number = float(len(" ".join(overrides)) + k)
        outcome = "failed" if k % 3 == 0 else "passed"
        columns = {"goal_rms_m": 1e-3 * number, "gas_g": 100.0 - number, "contacts": k % 2}
        flown.append(Flown(k, outcome, "settle_s" * (k % 3 == 0), columns, {"settle_s": True}))
    return flown


def pretend_with_log(base: str, batch: Sequence[Task]) -> list[Kept]:
    return [Kept(run.k, {"log.mcap": b"log"}, run.columns) for run in pretend(base, batch)]


def no_warm_up(base: str, batch: Sequence[Task]) -> None:
    """Nothing is compiled."""


def hold(base: str, overrides: Sequence[str]) -> Experiment:
    """What is flown is never looked at."""
    return load(find("hold"))


@pytest.fixture
def crew() -> Callable[[int], Crew]:
    return lambda jobs=1: Crew(pretend, pretend_with_log, no_warm_up, hold, jobs)


@pytest.fixture
def write(tmp_path: Path) -> Callable[..., Path]:
    """Write a campaign file."""

    def write_file(file: str = "campaign.toml", **keys: Any) -> Path:
        tree = {"name": "try", "experiment": "hold", **keys}
        path = tmp_path / file
        path.write_text(tomli_w.dumps(tree), encoding="utf-8")
        return path

    return write_file
