"""Run folders of a rig, scored like runs of a campaign: how a table gets into the benchmark.

The place of a vehicle is what its estimator said at every tick, for on a table nobody knows better.
On the twin that is the truth within the estimator's error.
"""

import struct
from pathlib import Path

import msgspec
import numpy as np
from mcap.exceptions import McapError
from mcap.reader import make_reader

from testbed.campaign.row import Flown, columns_of, outcome_of, within
from testbed.campaign.score import beside_metrics
from testbed.config import ConfigError, Experiment, load
from testbed.core.types import Tick
from testbed.metrics.run_metrics import Metrics, Track

NEEDED = ("config.toml", "log.mcap", "metrics.json")


def track_of(folder: Path, experiment: Experiment) -> Track:
    """Where the vehicles thought they were, at every tick at which all of them knew."""
    names = list(experiment.vehicles)
    decode = msgspec.json.Decoder(Tick).decode
    seen: dict[float, dict[str, list[float]]] = {}
    with (folder / "log.mcap").open("rb") as file:
        topics = [f"/{name}/tick" for name in names]
        for _, channel, message in make_reader(file).iter_messages(topics=topics):
            state = decode(message.data).outputs.state
            if state is not None:
                row = [
                    *(state.pose.x, state.pose.y, state.pose.theta),
                    *(state.twist.vx, state.twist.vy, state.twist.omega),
                ]
                name = channel.topic.split("/")[1]
                seen.setdefault(message.log_time * 1e-9, {})[name] = row
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
    except (McapError, msgspec.DecodeError, struct.error) as error:
        found = f"{type(error).__name__}: {error}".removesuffix(": ")
        raise ConfigError(str(folder / "log.mcap"), "", "the whole log of a run", found) from None
    extra = beside_metrics(experiment, track)
    outcome, reason = outcome_of(metrics)
    columns = columns_of(metrics, experiment, extra)
    return within(Flown(k, outcome, reason, columns, metrics.criteria or {}), most, least)
