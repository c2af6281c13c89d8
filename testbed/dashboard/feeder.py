"""The dashboard's own process: follows a run's log and tells a viewer.

    python -m testbed.dashboard.feeder RUN URL

It is started and watched by `testbed dash`. A viewer that does not answer blocks this process and
no other: the flight has nothing to do with it, and its log is what keeps the news meanwhile.
"""

import os
import sys
from itertools import islice
from pathlib import Path
from threading import Event

import rerun as rr

from testbed.config import ConfigError, load
from testbed.dashboard.blueprint import blueprint
from testbed.dashboard.scene import Scene
from testbed.logs.feed import Feed, LogFeed
from testbed.logs.log_reader import LogError, LogReader, config_of, log_of

PERIOD_S = 0.04  # between two pictures: 25 Hz
NOTHING, SEVERED = 1, 2  # exit codes: there is nothing to tell; nobody to tell it
BATCH = 5000  # messages at once, when there is something to catch up with


def tell(run: Path, url: str) -> None:
    """Show a run from its beginning until it ends."""
    scenario = load(config_of(run))
    recording = rr.RecordingStream("airbearing-testbed", recording_id=f"{run.name}-{os.getpid()}")
    plan = blueprint(scenario, live=True)
    recording.connect_grpc(url, default_blueprint=plan)
    recording.send_blueprint(plan)
    book = wait_for(log_of(run))
    follow(LogFeed(book), Scene(scenario, recording), recording)
    for line in book.said():
        sys.stderr.write(f"dashboard: warning: {line}\n")


def follow(feed: Feed, scene: Scene, recording: rr.RecordingStream, batch: int = BATCH) -> None:
    """Draw what comes until nothing will come any more."""
    pause = Event()
    while True:
        ended, news = feed.ended, feed.news()
        while some := list(islice(news, batch)):
            scene.draw(some)
            recording.flush()  # waits for a viewer that is stopped: rerun would gather 300 MB
        if ended:
            break
        pause.wait(PERIOD_S)
    scene.finish()
    recording.flush()


def wait_for(path: Path) -> LogReader:
    """The log, as soon as the run has begun it."""
    pause = Event()
    while True:
        if path.exists() and path.stat().st_size > 8:
            return LogReader(path)
        pause.wait(PERIOD_S)


def main() -> int:
    """The exit code, and a line on stderr if there is nothing to tell."""
    try:
        tell(Path(sys.argv[1]), sys.argv[2])
    except (LogError, ConfigError) as error:
        sys.stderr.write(f"dashboard: {error}\n")
        return NOTHING
    except RuntimeError as error:
        if "gRPC" not in str(error):  # rerun has no class for it
            raise
        return SEVERED  # whoever has started us starts the viewer and us again
    return 0


if __name__ == "__main__":
    code = main()
    sys.stderr.flush()
    os._exit(code)  # rerun's exit may wait for a viewer that is gone
