"""Reads run folders as runs of a campaign, so that table flights can enter the benchmark.

The position of a vehicle is its estimate at every tick, because a table has no ground truth. On the
twin it equals the truth within the estimator's error.
"""

from pathlib import Path

import msgspec
import numpy as np

from testbed.campaign.row import FlownRun, columns_of, outcome_of, within
from testbed.campaign.score import beside_metrics
from testbed.config import ConfigError, Experiment, load
from testbed.core.types import Tick
from testbed.logs.log_reader import UNREADABLE, LogError, LogReader
from testbed.logs.message import Decoder
from testbed.metrics.run_metrics import Metrics, Track

NEEDED = ("config.toml", "log.mcap", "metrics.json")


def track_of(folder: Path, experiment: Experiment) -> Track:
    """Estimated states of all vehicles, at every tick at which all have an estimate.

    Raises:
        LogError: a part of the log is missing.
    """
    names = list(experiment.vehicles)
    book, decode = LogReader(folder / "log.mcap"), Decoder(Tick).decode
    topics = {f"/{name}/tick": name for name in names}
    seen: dict[float, dict[str, list[float]]] = {}
    for topic, stamp, data in book.read():
        if topic not in topics or (state := decode(data).outputs.state) is None:
            continue
        row = [
            *(state.pose.x, state.pose.y, state.pose.theta),
            *(state.twist.vx, state.twist.vy, state.twist.omega),
        ]
        seen.setdefault(stamp * 1e-9, {})[topics[topic]] = row
    if not book.complete():
        raise LogError("; ".join(book.said()) or "the log is incomplete")
    whole = {t: rows for t, rows in sorted(seen.items()) if len(rows) == len(names)}
    states = [[rows[name] for name in names] for rows in whole.values()]
    return Track(np.array(list(whole)), np.array(states).reshape(-1, len(names), 6))


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
    outcome, reason = outcome_of(metrics)
    columns = columns_of(metrics, experiment, extra)
    return within(FlownRun(k, outcome, reason, columns, metrics.criteria or {}), most, least)
