"""Flies one run of a campaign in a worker, without screen, files or signals."""

import resource
import tempfile
import time
import traceback
from collections.abc import Sequence
from contextlib import redirect_stderr, suppress
from io import StringIO
from pathlib import Path

from msgspec.structs import replace

from testbed.campaign.row import FlownRun, Kept, Number, Task, columns_of, outcome_of
from testbed.campaign.score import beside_metrics
from testbed.config import ConfigError, Experiment, dump, loads
from testbed.realtime.law_watch import complaint, patience
from testbed.realtime.scheduling import settle, steady_memory
from testbed.rig.chain import watched
from testbed.rig.observers import MetricsObserver
from testbed.rig.twin import make_twin, warm_up
from testbed.run.code_digest import own_version
from testbed.run.fly import fly_and_judge
from testbed.run.folder import write_config, write_metrics
from testbed.run.judge import measure


def fly(base: str, k: int, overrides: Sequence[str]) -> FlownRun:
    """Fly run k, the base experiment with overrides; errors are returned in the result."""
    began = time.perf_counter()
    columns: dict[str, Number] = {}
    criteria: dict[str, bool] = {}
    seed, fault_t, fault = None, None, None
    try:
        experiment = read(base, overrides)
        seed = experiment.seed
        judge = MetricsObserver(experiment.vehicles)
        with watched(experiment, slow=False):  # a result must not depend on the machine's speed
            rig = make_twin(experiment)
            with steady_memory():
                ending = rig.fly(judge)
            if ending.fault is None and (complained := complaint()):
                ending = replace(ending, fault=complained)
        completed = ending.fault is None
        metrics = measure(rig, judge.aims, ending, 0.0, completed=completed)
        columns = columns_of(metrics, experiment, beside_metrics(experiment, rig.track()))
        (outcome, reason), criteria = outcome_of(experiment, metrics), metrics.criteria or {}
        fault, fault_t = ending.fault, ending.found_t
    except ConfigError as error:
        outcome = "refused"
        reason = f"{error.key}: expected {error.expected}, found {error.found}"
    except KeyboardInterrupt:
        raise
    except BaseException:  # even if a law exits, the campaign continues and shows it
        outcome, reason = "error", traceback.format_exc(limit=-4)
    reason = _spelled(reason)
    if fault is not None:
        fault = replace(fault, text=_spelled(fault.text))
    wall = time.perf_counter() - began
    memory_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    return FlownRun(k, outcome, reason, columns, criteria, wall, memory_mb, seed, fault_t, fault)


def _spelled(text: str) -> str:
    """The same text as valid UTF-8: half a character is spelled."""
    return text.encode(errors="backslashreplace").decode()


def fly_batch(base: str, batch: Sequence[Task]) -> list[FlownRun]:
    """Fly some runs in sequence."""
    return [fly(base, *task) for task in batch]


def warm(base: str, batch: Sequence[Task]) -> None:
    """Fly some runs for a moment, so that their code is compiled to disk."""
    for _, overrides in batch:
        with suppress(Exception, SystemExit):  # errors are reported when the run flies
            experiment = read(base, overrides)
            with watched(experiment, slow=False), patience():
                warm_up(experiment, lambda: False)
    settle()


def fly_with_log(base: str, batch: Sequence[Task]) -> list[Kept]:
    """Fly some runs again, with logs."""
    return [_keep(base, *task) for task in batch]


def _keep(base: str, k: int, overrides: Sequence[str]) -> Kept:
    columns: dict[str, Number] = {}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        try:
            experiment = read(base, overrides)
            write_config(folder, dump(experiment), own_version())
            # standard error belongs to the campaign
            with redirect_stderr(StringIO()), watched(experiment, slow=False):
                metrics = fly_and_judge(experiment, folder)
            write_metrics(folder, metrics)
            columns = columns_of(metrics, experiment, {})
        except KeyboardInterrupt:
            raise
        except BaseException:  # the same error that ended the first flight
            text = traceback.format_exc().encode(errors="backslashreplace")
            (folder / "error.txt").write_bytes(text)
        files = {path.name: path.read_bytes() for path in sorted(folder.iterdir())}
    return Kept(k, files, columns)


def read(base: str, overrides: Sequence[str]) -> Experiment:
    """The base experiment with overrides."""
    return loads(base, overrides)
