"""The flight in a run folder, from files that are of the same run."""

import tomllib
from collections.abc import Callable, Collection, Iterable
from itertools import takewhile
from pathlib import Path
from typing import NamedTuple

from testbed.config import Experiment
from testbed.logs.history import History, gather
from testbed.logs.log_reader import LogError, LogReader
from testbed.metrics.run_metrics import Metrics
from testbed.run.missing_parts import lacks, metrics_of
from testbed.run.post_mortem import judged

FIRST_NS = 1_000_000_000  # of a log; each vehicle has a tick in it
SAME_NS = 1_000_000  # two times of the beginning of one flight differ by less


class MixedUpError(LogError):
    """The files in a run folder are of different runs."""


class Recorded(NamedTuple):
    """A flight as its folder holds it."""

    history: History
    metrics: Metrics
    missing: list[str]  # a line for each part of the log that is missing


def recorded(
    log: Path, experiment: Experiment, warn: Callable[[list[str]], None] = lambda lines: None
) -> Recorded:
    """Read a log, and the metrics beside it.

    Args:
        log: log of a run.
        experiment: of the same run.
        warn: called with a line for each part of the log that is missing.

    Raises:
        LogError: the log has no ticks, or cannot be read.
        MixedUpError: log, metrics and experiment are not of the same run.
    """
    book = LogReader(log)
    history = gather(book)
    missing = lacks(book)
    warn(missing)
    _check_vehicles(log, history.vehicles, experiment.vehicles)
    if not history.vehicles and _has_flown(metrics_of(log.parent)):
        raise LogError(
            where=str(log), expected="the ticks of a flight",
            found="there are no ticks in the log", hint="; ".join(missing),
        )  # fmt: skip
    metrics = judged(log.parent, log, experiment, history)
    _check_vehicles(log.parent / "metrics.json", metrics.vehicles, experiment.vehicles)
    check_flight(book, metrics)
    _check_experiment(log.parent / "config.toml", metrics, (experiment.name, experiment.seed))
    return Recorded(history, metrics, missing)


def check_files(log: Path) -> None:
    """Refuse a folder whose log, metrics.json and config.toml are not of the same run.

    The log is read up to FIRST_NS, the configuration without the law's file. Files that are
    missing, or cannot be read, are not judged: whoever needs them says so.

    Raises:
        LogError: the log cannot be read.
        MixedUpError: they are of different runs.
    """
    book = LogReader(log)
    rows = takewhile(lambda row: row[1] < FIRST_NS, book.read())
    seen = [topic.split("/")[1] for topic, *_ in rows if topic.endswith("/tick")]
    metrics, config = metrics_of(log.parent), log.parent / "config.toml"
    check_flight(book, metrics)
    try:
        tree = tomllib.loads(config.read_text(encoding="utf-8"))
        vehicles, flown = list(tree["vehicles"]), (tree["name"], tree["seed"])
    except (OSError, ValueError, KeyError, TypeError):
        return
    _check_vehicles(log, dict.fromkeys(seen), vehicles)
    if metrics is not None:
        _check_vehicles(log.parent / "metrics.json", metrics.vehicles, vehicles)
        _check_experiment(config, metrics, flown)


def check_flight(book: LogReader, metrics: Metrics | None) -> None:
    """Refuse a log whose flight began at another time than that of the metrics.

    Older metrics, and flights without a time of day, do not say when they began.

    Raises:
        MixedUpError: they are of different flights.
    """
    began = None if metrics is None else metrics.epoch_ns
    has_beginning = not book.damages or book.damages[0].since is not None
    if began is None or not book.epoch or not has_beginning:
        return
    if abs(book.epoch - began) > SAME_NS:
        raise MixedUpError(
            where=str(book.path), expected="the log of the flight in metrics.json",
            found="the log of a flight that began at another time",
            hint="a file in this folder is of another run",
        )  # fmt: skip


def _check_vehicles(path: Path, found: Iterable[str], vehicles: Collection[str]) -> None:
    if strange := [name for name in found if name not in vehicles]:
        raise MixedUpError(
            where=str(path), expected=f"vehicles of config.toml: {', '.join(vehicles)}",
            found=", ".join(strange), hint="a file in this folder is of another run",
        )  # fmt: skip


def _check_experiment(path: Path, metrics: Metrics, found: tuple[str, int]) -> None:
    flown = metrics.experiment, metrics.seed
    if flown != found:
        wanted, other = (f"{name}, seed {seed}" for name, seed in (flown, found))
        raise MixedUpError(
            where=str(path), expected=f"the experiment of metrics.json: {wanted}", found=other,
            hint="a file in this folder is of another run",
        )  # fmt: skip


def _has_flown(metrics: Metrics | None) -> bool:
    return metrics is None or metrics.duration_s > 0.0
