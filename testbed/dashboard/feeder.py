"""The dashboard's own process: follows a run's log and sends it to a viewer.

    python -m testbed.dashboard.feeder RUN URL

`testbed dash` starts and supervises it. A viewer that does not respond blocks only this process:
the flight does not depend on it, and the log keeps all data meanwhile.
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
from testbed.logs.log_reader import LogError, await_log, config_of, log_of

PERIOD_S = 0.04  # between two updates: 25 Hz
NOTHING, SEVERED = 1, 2  # exit codes: no log to show; viewer disconnected
BATCH = 5000  # messages per update when catching up


def feed(run: Path, url: str) -> None:
    """Send a run to the viewer, from its beginning until it ends."""
    scenario = load(config_of(run))
    recording = rr.RecordingStream("airbearing-testbed", recording_id=f"{run.name}-{os.getpid()}")
    plan = blueprint(scenario, live=True)
    recording.connect_grpc(url, default_blueprint=plan)
    recording.send_blueprint(plan)
    book = await_log(log_of(run))
    follow(LogFeed(book), Scene(scenario, recording), recording)
    for line in book.missing():
        sys.stderr.write(f"dashboard: warning: {line}\n")


def follow(feed: Feed, scene: Scene, recording: rr.RecordingStream, batch: int = BATCH) -> None:
    """Draw new messages until the log is complete."""
    pause = Event()
    while True:
        ended, news = feed.ended, feed.news()
        while some := list(islice(news, batch)):
            scene.draw(some)
            recording.flush()  # waits for a stopped viewer: rerun would buffer 300 MB
        if ended:
            break
        pause.wait(PERIOD_S)
    scene.finish()
    recording.flush()


def main() -> int:
    """Run the feeder; returns the exit code and writes errors to stderr."""
    try:
        feed(Path(sys.argv[1]), sys.argv[2])
    except (LogError, ConfigError) as error:
        sys.stderr.write(f"dashboard: {error}\n")
        return NOTHING
    except RuntimeError as error:
        if "gRPC" not in str(error):  # rerun has no exception class for a lost connection
            raise
        return SEVERED  # the parent process restarts the viewer and this process
    return 0


if __name__ == "__main__":
    code = main()
    sys.stderr.flush()
    os._exit(code)  # a normal exit may wait in rerun for a viewer that is gone
