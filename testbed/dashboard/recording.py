"""A run for the rerun viewer: the log as its recording."""

from pathlib import Path

import rerun as rr

from testbed.cli.refusal import warn
from testbed.cli.replay import config_of
from testbed.config import ConfigError, load
from testbed.dashboard.blueprint import blueprint
from testbed.dashboard.scene import Scene
from testbed.files import whole
from testbed.logs.export import refuse_older
from testbed.logs.feed import LogFeed
from testbed.logs.log_reader import LogError, LogReader, log_of

BATCH = 500  # messages


def write_recording(run: Path, out: Path) -> Path:
    """Draw a whole run into a file."""
    refuse_older(out)
    try:
        scenario = load(config_of(run))
    except ConfigError as error:
        raise LogError(str(error)) from None
    book = LogReader(log_of(run))
    recording = rr.RecordingStream("airbearing-testbed", recording_id=str(run.resolve()))
    with whole(out) as part:
        recording.set_sinks(rr.FileSink(part))
        recording.send_blueprint(blueprint(scenario, live=False))
        scene, batch = Scene(scenario, recording), []
        for one in LogFeed(book).news():
            batch.append(one)
            if len(batch) >= BATCH and one.topic == "/truth":
                scene.draw(batch)
                batch = []
        scene.draw(batch)
        recording.flush()
        recording.disconnect()
    warn(book.said())
    return out
