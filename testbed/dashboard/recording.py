"""A run for the rerun viewer: the log as its recording."""

from collections.abc import Callable
from itertools import islice
from pathlib import Path

import rerun as rr

from testbed.config import ConfigError, load
from testbed.dashboard.blueprint import blueprint
from testbed.dashboard.scene import Scene
from testbed.files import atomic_write
from testbed.logs.export import refuse_older
from testbed.logs.feed import LogFeed
from testbed.logs.log_reader import LogError, LogReader, config_of, log_of

BATCH = 5000  # messages at once; what is drawn does not depend on it


def write_recording(
    run: Path, out: Path, warn: Callable[[list[str]], None] = lambda lines: None
) -> Path:
    """Draw a whole run into a file; `warn` is handed a line for each damaged place of its log."""
    refuse_older(out)
    try:
        scenario = load(config_of(run))
    except ConfigError as error:
        raise LogError(str(error)) from None
    book = LogReader(log_of(run))
    recording = rr.RecordingStream("airbearing-testbed", recording_id=str(run.resolve()))
    with atomic_write(out) as part:
        recording.set_sinks(rr.FileSink(part))
        recording.send_blueprint(blueprint(scenario, live=False))
        scene, news = Scene(scenario, recording), LogFeed(book).news()
        while batch := list(islice(news, BATCH)):
            scene.draw(batch)
        scene.finish()
        recording.flush()
        recording.disconnect()
    warn(book.said())
    return out
