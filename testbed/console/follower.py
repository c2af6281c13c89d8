"""Follows a run's folder and puts a new picture on the hub ten times a second.

The flight sends nothing here: its log is read while it grows. So a page costs the flight nothing,
shows the twin, the bench and the table alike, and a page opened late shows the run so far.
"""

from itertools import islice
from pathlib import Path
from threading import Event
from typing import Any

import msgspec

from testbed.config import ConfigError, Experiment, load
from testbed.console.checklist import items_of, read_checks
from testbed.console.hub import Hub
from testbed.console.picture import LivePicture
from testbed.console.scene import scene
from testbed.logs.feed import LogFeed
from testbed.logs.log_reader import LogError, LogReader, config_of
from testbed.metrics.run_metrics import Metrics
from testbed.report.verdict import NOTHING_TO_JUDGE

PERIOD_S = 0.1
BATCH = 5000  # messages between two pictures when catching up
METRICS = "metrics.json"
BEFORE = ("", "DISARMED", "ARMED")  # phases before a flight


class Follower:
    """Reads one run.

    Args:
        run: its folder.
        hub: gets the pictures.
    """

    def __init__(self, run: Path, hub: Hub) -> None:
        self._run, self._hub = run, hub
        self.scene: bytes = b"null"  # JSON; null before the experiment is read

    def follow(self, left: Event) -> None:
        """Follow until `left` is set."""
        scenario = self._experiment(left)
        if scenario is None:
            return
        self.scene = msgspec.json.encode(scene(scenario))
        self._hub.set_status(scene=True, trouble="")
        picture, feed, ended = LivePicture(scenario), None, False
        while not ended:
            feed = feed or self._log()
            if feed is not None:
                try:
                    self._read(feed, picture)
                except LogError as error:
                    self._hub.set_status(trouble=str(error))
                    return
            ended = self._status(picture) or left.wait(PERIOD_S)
        if feed is not None:
            self._read(feed, picture)
        self._status(picture)

    def _experiment(self, left: Event) -> Experiment | None:
        while not left.is_set():
            try:
                return load(config_of(self._run))
            except (LogError, ConfigError, OSError) as error:
                self._hub.set_status(trouble=f"no experiment in {self._run}: {error}")
            left.wait(PERIOD_S)
        return None

    def _log(self) -> LogFeed | None:
        path = self._run / "log.mcap"
        if not path.exists() or path.stat().st_size <= 8:
            return None
        self._hub.set_status(trouble="")
        return LogFeed(LogReader(path))

    def _read(self, feed: LogFeed, picture: LivePicture) -> None:
        news = feed.news()
        while batch := list(islice(news, BATCH)):
            picture.take(batch)
            events = [[round(s.t, 2), ", ".join(s.who), s.level, s.words] for s in picture.events]
            self._hub.put(picture.now(), (picture.pulses, picture.trail, events))
            picture.clear()

    def _status(self, picture: LivePicture) -> bool:
        """Tell the checklist and the verdict; whether the run is finished."""
        before = picture.t <= 0.0 and picture.phase.phase in BEFORE
        metrics = self._metrics()
        checks = read_checks(self._run) if before else []
        if metrics is not None and metrics.red:
            checks = checks or items_of(metrics.red)
        self._hub.set_status(
            checks=[] if metrics is not None and not metrics.red else checks,
            verdict=None if metrics is None else verdict(metrics),
        )
        return metrics is not None

    def _metrics(self) -> Metrics | None:
        try:
            return msgspec.json.decode((self._run / METRICS).read_bytes(), type=Metrics)
        except (OSError, msgspec.MsgspecError):
            return None


def verdict(metrics: Metrics) -> dict[str, Any]:
    """How a finished run ended, in words and as a level."""
    if metrics.red:
        return {"words": "not started: a check is red", "level": "bad"}
    if metrics.fault:
        return {"words": f"FAULT {metrics.fault}", "level": "bad"}
    if metrics.contacts and metrics.touches:
        hit = metrics.touches[0]
        return {"words": f"{hit.vehicle} hit {hit.other} at {hit.t:.1f} s", "level": "bad"}
    if not metrics.completed:
        return {"words": f"interrupted at {metrics.duration_s:.1f} s", "level": "off"}
    failed = [name for name, met in (metrics.criteria or {}).items() if not met]
    if failed:
        return {"words": f"flown; not met: {', '.join(failed)}", "level": "warn"}
    if not metrics.criteria:
        return {"words": f"flown; {NOTHING_TO_JUDGE}", "level": "off"}
    return {"words": "flown; all criteria met", "level": "ok"}
