"""The operator's command, in this process or in one of its own."""

import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import pytest
from click.testing import CliRunner, Result
from mcap.reader import make_reader

from testbed.cli.main import main
from testbed.core.records import cdr
from testbed.core.records import standard as _standard  # noqa: F401 (fills MESSAGES)
from testbed.core.records.definition import MESSAGES

ROOT = Path(__file__).resolve().parents[2]


class Log(NamedTuple):
    """A log, read whole."""

    messages: dict[str, list[tuple[int, dict[str, Any]]]]  # topic -> (time [ns], message)
    schemas: dict[str, tuple[str, str]]  # topic -> encoding, name


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The current folder, empty."""
    folder = tmp_path / "here"
    folder.mkdir()
    monkeypatch.chdir(folder)
    return folder


@pytest.fixture
def testbed() -> Callable[..., Result]:
    """Call the command in this process."""

    def call(*words: str | Path) -> Result:
        result = CliRunner().invoke(main, [str(word) for word in words])
        assert result.exception is None or isinstance(result.exception, SystemExit), result.output
        return result

    return call


def hear_interrupts() -> None:
    """A shell that starts the tests with `&` has them, and all their processes, ignore Ctrl-C."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


@pytest.fixture
def start() -> Iterator[Callable[..., subprocess.Popen[str]]]:
    """Start the command in a process of its own; what is left of it is ended afterwards."""
    processes = []

    def start_process(
        *words: str | Path, wrapper: Sequence[str] = (), **env: str
    ) -> subprocess.Popen[str]:
        process = subprocess.Popen(
            [*wrapper, sys.executable, "-m", "testbed", *map(str, words)],
            stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
            env=os.environ | {"PYTHONPATH": str(ROOT)} | env, preexec_fn=hear_interrupts,
        )  # fmt: skip
        processes.append(process)
        return process

    yield start_process
    for process in processes:
        process.kill()
        process.communicate()


@pytest.fixture
def read_log() -> Callable[[Path], Log]:
    """Open a run folder's log as a stranger would."""

    def read(folder: Path) -> Log:
        messages: dict[str, list[tuple[int, dict[str, Any]]]] = {}
        schemas, epoch = {}, None
        with (folder / "log.mcap").open("rb") as file:
            reader = make_reader(file, validate_crcs=True)
            assert reader.get_summary() is not None  # it was ended properly
            for schema, channel, message in reader.iter_messages(log_time_order=False):
                assert channel.message_encoding == "cdr"
                kind = schema.name.replace("/msg/", "/").removeprefix("testbed_msgs/")
                found = cdr.decode(MESSAGES[kind], message.data)
                if epoch is None:
                    epoch = message.log_time - round(1e9 * found["t"])
                row = (message.log_time - epoch, found)
                messages.setdefault(channel.topic, []).append(row)
                schemas[channel.topic] = (schema.encoding, schema.name)
        return Log(messages, schemas)

    return read
