"""Reads run folders as runs of a campaign, so that table flights can enter the benchmark.

The position of a vehicle is its estimate at every tick, because a table has no ground truth. On the
twin it equals the truth within the estimator's error.
"""

from functools import reduce
from pathlib import Path

import msgspec
import numpy as np

from testbed.campaign.row import FlownRun, columns_of, outcome_of, within
from testbed.campaign.score import beside_metrics
from testbed.config import ConfigError, Experiment, load
from testbed.logs.columns import Columns
from testbed.logs.log_reader import UNREADABLE, LogError, LogReader
from testbed.metrics.run_metrics import Metrics, Track
from testbed.run.recorded import MixedUpError, check_files

NEEDED = ("config.toml", "log.mcap", "metrics.json")


def track_of(folder: Path, experiment: Experiment) -> Track:
    """Estimated states of all vehicles, at every tick at which all have an estimate.

    Raises:
        LogError: a part of the log is missing.
    """
    names = list(experiment.vehicles)
    book = LogReader(folder / "log.mcap")
    log, names = Columns(book), list(experiment.vehicles)
    if not book.complete():
        raise LogError("; ".join(book.missing()) or "the log is incomplete")
    ticks = {name: log.rows[f"/{name}/tick"] for name in names if f"/{name}/tick" in log.rows}
    known = {name: one[one["outputs"]["state_known"] > 0] for name, one in ticks.items()}
    if len(known) < len(names):
        return Track(np.zeros(0), np.zeros((0, len(names), 6)))
    t = [one["inputs"]["t"] for one in known.values()]
    common = reduce(np.intersect1d, t)
    states = []
    for one, at in zip(known.values(), t, strict=True):
        state = one[np.isin(at, common)]["outputs"]["state"]
        states.append(np.column_stack([
            *(state["pose"][n] for n in ("x", "y", "theta")),
            *(state["twist"][n] for n in ("vx", "vy", "omega")),
        ]))  # fmt: skip
    return Track(common, np.stack(states, axis=1))


def read_run(folder: Path, k: int, most: dict[str, float], least: dict[str, float]) -> FlownRun:
    """Read a run folder as a run of a campaign.

    Raises:
        ConfigError: it is not a run folder.
    """
    for name in NEEDED:
        if not (folder / name).is_file():
            raise ConfigError(
                str(folder), "", f"a run folder with {', '.join(NEEDED)}", f"no {name}"
            )
    try:
        check_files(folder / "log.mcap")
    except MixedUpError as error:
        raise ConfigError(error.where, "", error.expected, error.found, error.hint) from None
    except (LogError, *UNREADABLE):
        pass  # `track_of` says why
    experiment = load(folder / "config.toml")
    try:
        metrics = msgspec.json.decode((folder / "metrics.json").read_bytes(), type=Metrics)
    except msgspec.DecodeError as error:
        raise ConfigError(
            str(folder / "metrics.json"), "", "metrics of a run", str(error)
        ) from None
    try:
        track = track_of(folder, experiment)
    except (LogError, *UNREADABLE) as error:
        where = str(folder / "log.mcap")
        raise ConfigError(where, "", "the complete log of a run", str(error)) from None
    extra = beside_metrics(experiment, track)
    outcome, reason = outcome_of(experiment, metrics)
    columns = columns_of(metrics, experiment, extra)
    run = FlownRun(
        k, outcome, reason, columns, metrics.criteria or {}, seed=experiment.seed,
        fault=metrics.fault_report, fault_t=metrics.fault_t,
    )  # fmt: skip
    return within(run, most, least)
