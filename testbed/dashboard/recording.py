"""Converts a run's log to a recording for the rerun viewer."""

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

BATCH = 5000  # messages at once; does not affect the result


def write_recording(
    run: Path, out: Path, warn: Callable[[list[str]], None] = lambda lines: None
) -> Path:
    """Write a complete run to `out`; `warn` gets a line for each damaged part of its log."""
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
    warn(book.missing())
    return out
