"""Run folders of a rig, scored like runs of a campaign: how a table gets into the benchmark.

The place of a vehicle is what its estimator said at every tick, for on a table nobody knows better.
On the twin that is the truth within the estimator's error.
"""

from pathlib import Path

import msgspec
import numpy as np

from testbed.campaign.row import Flown, columns_of, outcome_of, within
from testbed.campaign.score import beside_metrics
from testbed.config import ConfigError, Experiment, load
from testbed.core.types import Tick
from testbed.logs.log_reader import UNREADABLE, LogError, LogReader
from testbed.logs.message import Decoder
from testbed.metrics.run_metrics import Metrics, Track

NEEDED = ("config.toml", "log.mcap", "metrics.json")


def track_of(folder: Path, experiment: Experiment) -> Track:
    """Where the vehicles thought they were, at every tick at which all of them knew.

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
        raise LogError("; ".join(book.said()) or "it has no end")
    whole = {t: rows for t, rows in sorted(seen.items()) if len(rows) == len(names)}
    states = [[rows[name] for name in names] for rows in whole.values()]
    return Track(np.array(list(whole)), np.array(states).reshape(-1, len(names), 6))


def read_run(folder: Path, k: int, most: dict[str, float], least: dict[str, float]) -> Flown:
    """One run folder as a run.

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
        raise ConfigError(where, "", "the whole log of a run", str(error)) from None
    extra = beside_metrics(experiment, track)
    outcome, reason = outcome_of(metrics)
    columns = columns_of(metrics, experiment, extra)
    return within(Flown(k, outcome, reason, columns, metrics.criteria or {}), most, least)
