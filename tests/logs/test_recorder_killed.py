"""What is left of a log after its writers were killed, or its disk was full."""

import os
import re
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import msgspec
import numpy as np
import pytest
from mcap.reader import make_reader

from testbed.logs.frame_stream import frames_of, pieces_of
from testbed.logs.frames import Mark, Messages, One, Stack, Table, Topic
from testbed.logs.log_reader import LogReader
from testbed.logs.mcap_writer import Disk, DiskFullError, singly, write_log
from testbed.logs.packing import Packer
from testbed.logs.recorder import FAST_SPAN_NS, SPAN_NS, Recorder, RecorderError
from testbed.logs.truth import Motion, Truth

HERE = Motion(1.0, 2.0, 3.0, 0.1, 0.2, 0.3)
PERIOD = 0.01  # [s] of the run between two messages

# A flight at 100 Hz of wall time that says each time what it has handed over [ns].
FLIGHT = """
import sys, threading, time
from pathlib import Path
from testbed.logs.recorder import Recorder
from testbed.logs.truth import Motion, Truth

begun, pause = time.monotonic(), threading.Event()
with Recorder(Path(sys.argv[1])) as recorder:
    print(recorder._writer.pid, flush=True)
    for k in range(6000):
        t = k * 0.01
        pause.wait(max(0.0, begun + t - time.monotonic()))
        recorder.write("/truth", t, Truth(t, {"sat1": Motion(1.0, 2.0, 3.0, 0.1, 0.2, 0.3)}))
        recorder.mark(t)
        print(round(t * 1e9), flush=True)
"""


def stamps(path: Path) -> list[int]:
    return [row.stamp for row in LogReader(path).read() if row.topic == "/truth"]


def killed(path: Path, after: int, *, scribe_too: bool) -> int:
    """Kill a flight after so many messages; the stamp of the last one that it handed over [ns]."""
    flight = subprocess.Popen(
        [sys.executable, "-c", FLIGHT, str(path)], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL
    )
    writer = int(flight.stdout.readline())
    handle = os.pidfd_open(writer)  # readable when the process ends
    for _ in range(after):
        flight.stdout.readline()
    flight.send_signal(signal.SIGKILL)
    if scribe_too:
        signal.pidfd_send_signal(handle, signal.SIGKILL)
    rest, _ = flight.communicate()
    import select

    assert select.select([handle], [], [], 60.0)[0]
    os.close(handle)
    return int(rest.split()[-1]) if rest else (after - 1) * 10**7


def test_a_flight_killed_at_twenty_instants_loses_nothing(tmp_path):
    for k, after in enumerate(np.random.default_rng(20).integers(1, 60, 20).tolist()):
        path = tmp_path / f"{k}.mcap"
        handed_over = killed(path, after, scribe_too=False)
        found = stamps(path)
        assert found == [j * 10**7 for j in range(len(found))]
        assert found[-1] >= handed_over


def row_at(stamp: int) -> bytes:
    """A row of a time [ns]."""
    return Packer("Truth").pack((1e-9 * stamp,), [(0, b"")])


def chunked(count: int) -> list:
    """Frames of a 100 Hz flight with its marks."""
    sent, marked = [Topic("/truth", "Truth")], -SPAN_NS
    for k in range(count):
        now = k * 10**7
        sent.append(Messages([One(0, now, row_at(now))]))
        if now - marked >= SPAN_NS:
            sent.append(Mark())
            marked = now
    return sent


def test_a_log_is_readable_wherever_it_was_cut(tmp_path):
    """Both writers killed at once leave the beginning of the file, up to any byte."""
    whole = tmp_path / "whole.mcap"
    write_log(whole, iter(chunked(100)), Disk(lambda: 10**12, 0, 0), print)
    content = whole.read_bytes()
    for end in np.random.default_rng(1).integers(8, len(content), 200).tolist():
        cut = tmp_path / "cut.mcap"
        cut.write_bytes(content[:end])
        found = stamps(cut)
        assert found == [j * 10**7 for j in range(len(found))]


def test_what_is_marked_is_in_the_file(tmp_path):
    """So a writer that is killed has lost less than two tenths of a second."""
    path, lost = tmp_path / "log.mcap", []

    def watched():
        for frame in chunked(200):
            if isinstance(frame, Messages):
                found = stamps(path)
                lost.append(frame.parts[0].stamp - (found[-1] if found else 0))
            yield frame

    write_log(path, watched(), Disk(lambda: 10**12, 0, 0), print)
    assert max(lost) <= SPAN_NS


def test_both_killed_leave_a_readable_log(tmp_path):
    path = tmp_path / "log.mcap"
    killed(path, 50, scribe_too=True)
    found = stamps(path)
    assert found == [j * 10**7 for j in range(len(found))]


def test_a_log_grows_under_its_reader(tmp_path):
    path, seen = tmp_path / "log.mcap", []
    sent = iter(chunked(100))

    def half():
        for _ in range(60):
            yield next(sent)
        book = LogReader(path)
        seen.append([row.stamp for row in book.read()])
        yield from sent
        seen.append(book)

    write_log(path, half(), Disk(lambda: 10**12, 0, 0), print)
    first, book = seen
    assert not book.finished
    assert 0 < len(first) < 60
    assert first + [row.stamp for row in book.read()] == [j * 10**7 for j in range(100)]
    assert book.finished
    assert book.kinds == {"/truth": "Truth"}


def test_damage_is_said(tmp_path):
    path = tmp_path / "log.mcap"
    write_log(path, iter(chunked(100)), Disk(lambda: 10**12, 0, 0), print)
    content = bytearray(path.read_bytes())
    at = content.index(b"zstd") + 30
    content[at] ^= 0xFF
    path.write_bytes(content)
    book = LogReader(path)
    found = [row.stamp for row in book.read()]
    assert found == [j * 10**7 for j in range(100 - len(found), 100)]
    assert "damaged at byte" in book.missing()[0]


# The disk


FULL = r"No space left on device: 0.0 MB are free, the log ends"


def test_it_warns_once_and_ends_the_log_properly_before_the_disk_is_full(tmp_path):
    room, said = iter(range(1000, 0, -100)), []
    path = tmp_path / "log.mcap"
    with pytest.raises(DiskFullError, match=FULL):
        write_log(path, iter(chunked(500)), Disk(lambda: next(room), 800, 450), said.append)
    assert said[0] == "ready"
    assert "left on the disk of the log" in said[1]
    assert said[2].startswith(f"full: {path}: No space left on device")
    assert len(said) == 3
    assert next(room, 0) == 0  # it went on until a quarter was left
    with path.open("rb") as file:
        summary = make_reader(file, validate_crcs=True).get_summary()
    assert summary.statistics.message_count == len(stamps(path)) > 0


def test_rows_on_their_way_to_a_full_disk_are_written(tmp_path):
    path, said = tmp_path / "log.mcap", []
    with pytest.raises(DiskFullError, match=FULL):
        write_log(path, iter(chunked(500)), Disk(lambda: 300, 0, 400), said.append)
    assert [line.split(" ")[0] for line in said] == ["ready", "full:"]
    assert len(stamps(path)) == 500


@pytest.mark.parametrize("span", [SPAN_NS, FAST_SPAN_NS], ids=["ticks", "far ahead"])
def test_a_flight_whose_disk_is_full_loses_no_row(tmp_path, span):
    """It may be seconds ahead of the writer when that finds out."""
    path, k = tmp_path / "log.mcap", 0
    full = 2 * shutil.disk_usage(tmp_path).free  # what is free is less, and more than a quarter

    def fly() -> None:
        nonlocal k
        with Recorder(path, warn_below=0, end_below=full, span_ns=span) as recorder:
            for k in range(10**6):
                recorder.write("/truth", PERIOD * k, Truth(PERIOD * k, {"sat1": HERE}))
                recorder.mark(PERIOD * k)

    with pytest.raises(RecorderError, match=f"^{re.escape(str(path))}: No space left on device"):
        fly()
    assert len(stamps(path)) == k + 1


def test_the_flight_hears_of_it(tmp_path):
    """The limits are above what any disk has: the writer warns, then ends."""

    def fly() -> None:
        with Recorder(tmp_path / "log.mcap", warn_below=10**18, end_below=10**18) as recorder:
            for k in range(10**6):
                recorder.write("/truth", PERIOD * k, Truth(PERIOD * k, {"sat1": HERE}))
                recorder.mark(PERIOD * k)

    with pytest.raises(RecorderError, match="No space left on device"):
        fly()
    assert stamps(tmp_path / "log.mcap")


@pytest.mark.parametrize("span", [SPAN_NS, 10**10], ids=["ticks", "blocks of ticks"])
def test_a_flight_that_goes_on_after_it_hears_the_same(span, tmp_path):
    """Rows that are still in memory when the writer ends are lost; the reason is not."""

    def fly() -> None:
        with Recorder(
            tmp_path / "log.mcap", warn_below=10**18, end_below=10**18, span_ns=span
        ) as recorder:
            for k in range(10**6):
                try:  # whichever call notices it first
                    recorder.write("/truth", PERIOD * k, Truth(PERIOD * k, {"sat1": HERE}))
                    recorder.mark(PERIOD * k)
                except RecorderError as error:
                    said.append(str(error))
                    break
            for k in range(3000):  # more than fits in a block or a pipe
                recorder.write("/truth", 1e4 + k, Truth(1e4 + k, {"sat1": HERE}))
                with pytest.raises(RecorderError, match="No space left on device"):
                    recorder.mark(1e4 + 20.0 * k)

    said: list[str] = []
    with pytest.raises(RecorderError, match="No space left on device") as last:
        fly()
    assert said == [str(last.value)]
    assert stamps(tmp_path / "log.mcap")


def test_a_warning_reaches_the_flight(tmp_path):
    heard: list[str] = []
    with Recorder(tmp_path / "log.mcap", warn_below=10**18, end_below=0) as recorder:
        k = 0
        while not heard:  # the writer says it as soon as it sees the first mark
            recorder.write("/truth", PERIOD * k, Truth(PERIOD * k, {"sat1": HERE}))
            heard += recorder.mark(PERIOD * k)
            k += 1
    assert heard[0].startswith("warning: ")


def test_a_write_that_fails_leaves_a_whole_file(tmp_path, monkeypatch):
    path, calls = tmp_path / "log.mcap", []
    write = os.write

    def full_at_last(descriptor: int, data: bytes) -> int:
        calls.append(len(data))
        if len(calls) == 8:
            write(descriptor, data[: len(data) // 2])
            raise OSError(28, "No space left on device")
        return write(descriptor, data)

    monkeypatch.setattr(os, "write", full_at_last)
    with pytest.raises(OSError, match="No space left"):
        write_log(path, iter(chunked(200)), Disk(lambda: 10**12, 0, 0), print)
    book = LogReader(path)
    assert len(list(book.read())) > 0
    assert book.finished
    with path.open("rb") as file:
        read = [m.log_time for *_, m in make_reader(file).iter_messages(log_time_order=False)]
    assert read == stamps(path)


def cuts(stream: bytes) -> Iterator[list[bytes]]:
    """The stream in pieces of several sizes."""
    for size in (1, 3, 7, 1000):
        yield [stream[k : k + size] for k in range(0, len(stream), size)]


def test_a_frame_that_is_cut_off_was_never_sent():
    frames = [Mark(), Messages([One(0, 5, b"abc")])]
    stream = b"".join(piece for frame in frames for piece in pieces_of(frame))
    for pieces in cuts(stream):
        assert list(frames_of(pieces)) == frames
    assert list(frames_of([stream[:-1]])) == [Mark()]


def test_memory_of_stacks_travels_beside_its_frame_and_comes_back():
    """Memory goes before the frame that has it, uncopied; a frame without it is packed alone."""
    rows = [np.frombuffer(data, np.uint8) for data in (b"-abc-def", b"-gh", b"ABCDEF")]
    stacks = [Stack(4, 1, memoryview(rows[0])), Stack(3, 1, memoryview(rows[1]))]
    table = Table([0, 1], [10, 20, 30], [stacks, [Stack(2, 0, memoryview(rows[2]))]], [])
    whole = Messages([One(3, 1, b"first"), table, One(0, 40, b"last")])
    pieces = list(pieces_of(whole))
    for data, row in zip([one for one in pieces if isinstance(one, memoryview)], rows, strict=True):
        assert np.shares_memory(np.frombuffer(data, np.uint8), row)
    short, packed = Messages([One(0, 5, b"x")]), msgspec.msgpack.encode
    stream = b"".join((*pieces, *pieces_of(short)))
    assert stream.count(b"abc") == 1
    for pieces in cuts(stream):
        first, second = frames_of(pieces)
        assert packed(first) == packed(whole)
        assert second == short


def test_nothing_of_a_frame_that_cannot_be_packed_is_sent():
    stacks = [[Stack(2, 0, memoryview(b"AB"))]]
    with pytest.raises(OverflowError):
        next(pieces_of(Messages([Table([1 << 70], [10], stacks, [])])))


def test_a_table_gives_its_messages_time_by_time():
    """Columns may be in several stacks of other sizes; more messages stand at their places."""
    first = [Stack(4, 1, memoryview(b"-abc-def")), Stack(3, 1, memoryview(b"-gh"))]
    second = [Stack(2, 0, memoryview(b"ABCDEF"))]
    between = [(0, One(2, 7, b"before")), (1, One(3, 10, b"after")), (3, One(3, 30, b"last"))]
    table = Table([0, 1], [10, 20, 30], [first, second], between)
    assert len(Messages([table, One(0, 40, b"")])) == 10
    (part,) = msgspec.msgpack.decode(msgspec.msgpack.encode(Messages([table])), type=Messages).parts
    assert [(one.topic, one.stamp, one.data) for one in singly(part)] == [
        (2, 7, b"before"), (0, 10, b"abc"), (1, 10, b"AB"), (3, 10, b"after"),
        (0, 20, b"def"), (1, 20, b"CD"), (0, 30, b"gh"), (1, 30, b"EF"), (3, 30, b"last"),
    ]  # fmt: skip
    assert list(Stack(4, 1, memoryview(b"-abc-def")).part(1, 2)) == [b"def"]


# Readers of others


def test_rerun_s_converter_opens_it(tmp_path):
    cli = pytest.importorskip("rerun_cli")
    with Recorder(tmp_path / "log.mcap") as recorder:
        for k in range(100):
            recorder.write("/truth", PERIOD * k, Truth(PERIOD * k, {"sat1": HERE}))
    rerun = Path(cli.__file__).parent / "rerun"
    assert shutil.which(str(rerun))
    out = tmp_path / "log.rrd"
    result = subprocess.run(
        [rerun, "mcap", "convert", tmp_path / "log.mcap", "-o", out],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert result.returncode == 0, result.stderr
    chunk = pytest.importorskip("rerun.chunk")
    paths = {str(c.entity_path) for c in chunk.RrdReader(str(out)).stream().to_chunks()}
    assert "/truth" in paths
