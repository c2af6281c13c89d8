"""A log that any MCAP reader opens, written by a process of its own."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from mcap.reader import make_reader

from testbed.core.records import cdr
from testbed.core.records.definition import MESSAGES
from testbed.core.records.ros import schema_text
from testbed.logs import recorder as recording
from testbed.logs.log_reader import LogReader
from testbed.logs.recorder import Recorder, RecorderError
from testbed.logs.tick_row import REPEAT_S
from testbed.logs.truth import Motion, Truth

HERE = Motion(1.0, 2.0, 3.0, 0.1, 0.2, 0.3)


def truth(t: float) -> Truth:
    return Truth(t, {"sat1": HERE})


def read(path: Path) -> list[tuple[str, int, int, dict]]:
    """Topic, time, number and message of every row but the names."""
    with path.open("rb") as file:
        return [
            (
                channel.topic, message.log_time, message.sequence,
                cdr.decode(MESSAGES["Truth"], message.data),
            )
            for _, channel, message in make_reader(file, validate_crcs=True).iter_messages(
                log_time_order=False
            )
            if channel.topic != "/names"
        ]  # fmt: skip


def test_messages_come_back_in_order_with_their_times(tmp_path):
    path = tmp_path / "log.mcap"
    with Recorder(path) as recorder:
        for k in range(1000):
            recorder.write("/truth" if k % 2 else "/other", 0.1 * k, truth(0.1 * k))
    rows = read(path)
    assert [topic for topic, *_ in rows[:4]] == ["/other", "/truth", "/other", "/truth"]
    assert [stamp for _, stamp, *_ in rows] == [k * 10**8 for k in range(1000)]
    numbers = [sequence for *_, sequence, _ in rows]  # the names stand between them
    assert numbers == sorted(set(numbers))
    assert (numbers[0], numbers[-1]) == (2, 1004)
    row = rows[7][3]
    assert row["t"] == 0.1 * 7
    assert row["vehicles"] == [
        {"pose": {"x": 1.0, "y": 2.0, "theta": 3.0}, "twist": {"vx": 0.1, "vy": 0.2, "omega": 0.3}}
    ]


def test_the_time_of_the_log_is_utc(tmp_path):
    path, noon = tmp_path / "log.mcap", 1_800_000_000_000_000_000
    with Recorder(path, epoch_ns=noon) as recorder:
        recorder.write("/truth", 2.5, truth(2.5))
    ((_, stamp, _, row),) = read(path)
    assert (stamp - noon, row["t"]) == (2_500_000_000, 2.5)
    book = LogReader(path)
    assert {one.stamp for one in book.read()} == {2_500_000_000}
    assert book.epoch == noon


def test_the_time_of_the_log_may_be_known_only_when_the_flight_begins(tmp_path):
    path, noon = tmp_path / "log.mcap", 1_800_000_000_000_000_000
    with Recorder(path, epoch_ns=noon - 8_000_000_000) as recorder:
        recorder.wait_for_writer()
        recorder.epoch_ns = noon
        recorder.write("/truth", 0.5, truth(0.5))
    book = LogReader(path)
    assert any(book.read())
    assert book.epoch == noon


def test_the_same_messages_give_the_same_bytes(tmp_path):
    for name in "ab":
        with Recorder(tmp_path / name) as recorder:
            for k in range(100):
                recorder.write("/truth", 0.1 * k, truth(0.1 * k))
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()


def test_an_empty_log_is_a_log(tmp_path):
    with Recorder(tmp_path / "log.mcap"):
        pass
    assert read(tmp_path / "log.mcap") == []


@pytest.mark.parametrize("error", [KeyboardInterrupt, RuntimeError])
def test_a_log_is_whole_when_its_flight_ends_badly(tmp_path, error):
    def fly() -> None:
        with Recorder(tmp_path / "log.mcap") as recorder:
            recorder.write("/truth", 0.0, truth(0.0))
            raise error

    with pytest.raises(error):
        fly()
    assert len(read(tmp_path / "log.mcap")) == 1


def test_an_older_log_is_not_touched(tmp_path):
    path = tmp_path / "log.mcap"
    path.write_text("mine")

    def fly() -> None:
        with Recorder(path) as recorder:
            recorder.write("/truth", 0.0, truth(0.0))

    with pytest.raises(RecorderError, match="File exists"):
        fly()
    assert path.read_text() == "mine"


def test_a_log_that_cannot_be_written_is_an_error(tmp_path):
    def fly() -> None:
        with Recorder(tmp_path / "nowhere" / "log.mcap") as recorder:
            for k in range(100_000):  # the pipe breaks on the way
                recorder.write("/truth", float(k), truth(float(k)))

    with pytest.raises(RecorderError, match="No such file"):
        fly()


def test_a_flight_that_is_killed_leaves_a_whole_log(tmp_path):
    path = tmp_path / "log.mcap"
    script = (
        "import sys; from pathlib import Path; from testbed.logs.recorder import *\n"
        "from testbed.logs.truth import Truth\n"
        "with Recorder(Path(sys.argv[1])) as r:\n"
        "    for k in range(20_000): r.write('/truth', k, Truth(k, {}))\n"
        "    print(r._writer.pid, flush=True)\n"
        "    sys.stdin.read()\n"
    )
    flight = subprocess.Popen(
        [sys.executable, "-c", script, str(path)], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    )
    writer = int(flight.stdout.readline())
    handle = os.pidfd_open(writer)  # readable when the process ends
    flight.send_signal(signal.SIGKILL)
    flight.communicate()
    import select

    assert select.select([handle], [], [], 30.0)[0]
    os.close(handle)
    assert len(read(path)) > 10_000


def test_vehicles_share_the_schema_of_a_kind(tmp_path):
    path = tmp_path / "log.mcap"
    with Recorder(path) as recorder:
        for topic in ("/a", "/b"):
            recorder.write(topic, 0.0, truth(0.0))
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
    schemas = {one.name: one for one in summary.schemas.values()}
    assert set(schemas) == {"testbed_msgs/msg/Truth", "testbed_msgs/msg/Names"}
    schema = schemas["testbed_msgs/msg/Truth"]
    assert (schema.encoding, schema.data.decode()) == ("ros2msg", schema_text("Truth"))
    found = {c.topic: (c.schema_id, c.message_encoding) for c in summary.channels.values()}
    assert found["/a"] == found["/b"] == (schema.id, "cdr")


@pytest.fixture
def stopped(tmp_path, monkeypatch):
    """A log whose writer was stopped after its first row; nothing is waited for long."""
    monkeypatch.setattr(recording, "LARGEST_BACKLOG", 1_000_000)

    def begin(**words) -> Recorder:
        recorder = Recorder(tmp_path / "log.mcap", **words)
        recorder.__enter__()
        recorder.write("/truth", 0.0, truth(0.0))
        recorder.mark(0.0)
        pid = recorder._writer.pid
        os.kill(pid, signal.SIGSTOP)
        os.waitid(os.P_PID, pid, os.WSTOPPED)
        monkeypatch.setattr(recording, "PATIENCE_S", 0.2)
        return recorder

    return begin


def test_a_flight_on_wires_does_not_wait_for_a_stopped_writer(stopped, tmp_path, monkeypatch):
    recorder, said = stopped(waits=False), []
    for k in range(1, 30_001):
        recorder.write("/truth", 0.1 * k, truth(0.1 * k))
        said += recorder.mark(0.1 * k)
    assert 0 < recorder.lost < 30_000
    assert len(said) == 1
    assert "rows of it are lost" in said[0]
    os.kill(recorder._writer.pid, signal.SIGCONT)
    monkeypatch.setattr(recording, "PATIENCE_S", 5.0)
    recorder.__exit__(None, None, None)
    kept = sum(1 for _ in LogReader(tmp_path / "log.mcap").read())
    names = round(3000.0 / REPEAT_S)  # a row each time
    assert 0 <= kept + recorder.lost - 30_001 - names <= 1


def test_a_flight_on_the_twin_ends_when_its_writer_is_stopped(stopped, tmp_path):
    recorder = stopped(waits=True)

    def fly() -> None:
        for k in range(30_000):
            recorder.write("/truth", 0.1 * k, truth(0.1 * k))

    with pytest.raises(RecorderError, match="took nothing"):
        fly()
    with pytest.raises(RecorderError, match="took nothing"):
        recorder.__exit__(None, None, None)


def test_the_end_does_not_wait_for_a_stopped_writer(stopped):
    recorder = stopped()
    with pytest.raises(RecorderError, match="did nothing"):
        recorder.__exit__(None, None, None)
