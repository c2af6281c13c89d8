"""What is left of a damaged log is read, what is lost is said, and no file does harm."""

import struct
import zlib
from pathlib import Path

import numpy as np
import pytest
import zstandard

from testbed.logs.frames import Epoch, Mark, Messages, One, Topic
from testbed.logs.log_reader import LogError, LogReader
from testbed.logs.mcap_record import HEAD, Message, read_chunk
from testbed.logs.mcap_writer import Disk, write_log
from testbed.logs.replay import before_damage

MAGIC = b"\x89MCAP0\r\n"
COUNT = 200  # messages, at 100 Hz
EPOCH = 1_800_000_000_000_000_000  # UTC of time 0 [ns]
CHUNK, INDEX, DATA_END = 6, 7, 15  # opcodes


@pytest.fixture(scope="module")
def content(tmp_path_factory) -> bytes:
    """A log of two seconds in two topics, a chunk for each two ticks."""
    path = tmp_path_factory.mktemp("log") / "log.mcap"
    rng = np.random.default_rng(5)

    def frames():
        yield Epoch(EPOCH)
        yield Topic("/sat1/pace", "Pace")
        yield Topic("/truth", "Truth")
        for k in range(COUNT):
            one = One(k % 2, k * 10**7, begun(k) + rng.bytes(40).hex().encode())
            yield Messages([one])
            if k % 4 == 3:
                yield Mark()

    write_log(path, frames(), Disk(lambda: 10**12, 0, 0), str)
    return path.read_bytes()


def begun(k: int) -> bytes:
    """The beginning of a row: CDR, then its time of the run."""
    return struct.pack("<4sd", b"\0\1\0\0", 0.01 * k)


def records(content: bytes) -> list[tuple[int, int, int]]:
    """Opcode, beginning and end of each."""
    at, found = len(MAGIC), []
    while at < len(content) - len(MAGIC):
        opcode, length = HEAD.unpack_from(content, at)
        found.append((opcode, at, at + HEAD.size + length))
        at = found[-1][2]
    return found


def chunks(content: bytes) -> list[tuple[int, int, list[int]]]:
    """Beginning, end and stamps of each."""
    return [
        (a, b, [
            r.stamp - EPOCH
            for r in read_chunk(content[a + HEAD.size : b], 2**30) if isinstance(r, Message)
        ])
        for opcode, a, b in records(content) if opcode == CHUNK
    ]  # fmt: skip


def read(tmp_path: Path, content: bytes) -> tuple[LogReader, list[int]]:
    path = tmp_path / "log.mcap"
    path.write_bytes(content)
    book = LogReader(path)
    return book, [row.stamp for row in book.read()]


def zeroed(content: bytes, a: int, b: int) -> bytes:
    return content[:a] + bytes(len(content[a:b])) + content[b:]


def flipped(content: bytes, at: int, mask: int) -> bytes:
    return content[:at] + bytes([content[at] ^ mask]) + content[at + 1 :]


def copies(content: bytes, rng: np.random.Generator):
    end = chunks(content)[-1][1]  # a tail of zeros after it costs nothing, which no reader can know
    for _ in range(10):
        yield zeroed(content, int(rng.integers(end)), len(content))
        at = int(rng.integers(len(content) - 700))
        yield zeroed(content, at, at + 700)
        yield flipped(content, int(rng.integers(len(content))), 1 << int(rng.integers(8)))


def test_every_chunk_that_is_untouched_is_read_and_every_loss_is_said(tmp_path, content):
    table = chunks(content)
    assert len(table) == COUNT // 4
    for copy in copies(content, np.random.default_rng(3)):
        book, found = read(tmp_path, copy)
        whole = [t for a, b, stamps in table if copy[a:b] == content[a:b] for t in stamps]
        names_lost = copy[table[0][0] : table[0][1]] != content[table[0][0] : table[0][1]]
        if not (names_lost and copy[-8:] != MAGIC):
            assert found == whole
        assert book.lost == bool(book.missing() and len(found) < COUNT)
        assert book.lost == (len(found) < COUNT)


@pytest.mark.parametrize(
    "spoil",
    [
        lambda c: c[:-1],
        lambda c: c[:-5],
        lambda c: flipped(c, len(c) - 3, 4),
        lambda c: flipped(c, len(c) - 40, 4),
        lambda c: c + b"xx" * 1000,
    ],
)
def test_damage_after_the_last_message_is_said(tmp_path, content, spoil):
    book, found = read(tmp_path, spoil(content))
    assert (len(found), book.lost, book.complete()) == (COUNT, False, False)
    (said,) = book.missing()
    assert said.endswith(": nothing of the flight is missing")


def test_a_whole_log_has_no_damage(tmp_path, content):
    book, found = read(tmp_path, content)
    assert found == [k * 10**7 for k in range(COUNT)]
    assert (book.finished, book.lost, book.missing(), book.complete()) == (True, False, [], True)


def test_place_time_and_number_of_what_is_missing_are_said(tmp_path, content):
    a, b, stamps = chunks(content)[10]
    book, found = read(tmp_path, flipped(content, b - 5, 0x10))
    assert stamps[0] == 400_000_000
    assert len(found) == COUNT - 4
    assert book.missing() == [
        f"{tmp_path / 'log.mcap'} is damaged at byte {a}: "
        "0.05 s of flight (0.39 s to 0.44 s) are missing, 4 messages"
    ]
    assert book.finished
    assert not book.complete()


def test_two_places_are_said_each(tmp_path, content):
    table = chunks(content)
    hurt = flipped(flipped(content, table[3][1] - 3, 1), table[20][1] - 3, 1)
    book, found = read(tmp_path, hurt)
    assert len(found) == COUNT - 8
    assert [one.at for one in book.damages] == [table[3][0], table[20][0]]


def test_after_a_power_loss_what_was_written_before_is_read(tmp_path, content):
    a, _, stamps = chunks(content)[30]
    book, found = read(tmp_path, zeroed(content, a, len(content)))
    assert found[-1] == stamps[0] - 10**7
    assert not book.finished
    assert book.missing()[0].endswith(f"byte {a}: the flight after 1.19 s is missing")


def test_the_last_chunk_is_missed_by_the_file_s_own_count(tmp_path, content):
    a, _, stamps = chunks(content)[-1]
    book, found = read(tmp_path, flipped(content, a + 4, 0x40))  # a length of a gigabyte
    assert found[-1] == stamps[0] - 10**7
    assert book.finished
    assert "(1.95 s to 1.99 s) are missing, 4 messages" in book.missing()[0]


def test_names_that_are_lost_are_taken_from_the_end_of_the_file(tmp_path, content):
    _, b, _ = chunks(content)[0]
    hurt = zeroed(content, 0, b)  # the beginning of the file, too
    book, found = read(tmp_path, hurt)
    assert len(found) == COUNT - 4
    assert book.kinds == {"/sat1/pace": "Pace", "/truth": "Truth"}
    assert "damaged at byte 0: 0.04 s" in book.missing()[0]
    assert book.missing()[0].endswith("4 messages")


def test_names_that_are_nowhere_are_said_with_what_they_cost(tmp_path, content):
    a, b, _ = chunks(content)[0]
    cut = records(content)[-20][1]
    book, found = read(tmp_path, zeroed(content, a, b)[:cut])
    assert found == []
    assert book.lost
    assert "because the names of their topics are in a damaged part" in book.missing()[-1]


def test_a_schema_that_is_lost_is_known_by_the_name_of_its_topic(tmp_path):
    channel = rec(4, struct.pack("<HH", 1, 9) + text("/sat1/host") + text("json") + bytes(4))
    book, found = read(tmp_path, MAGIC + header() + packed(channel + message(1)))
    assert (found, book.kinds) == ([1], {"/sat1/host": "HostTick"})


def test_damage_between_chunks_costs_nothing(tmp_path, content):
    for opcode, a, _ in records(content):
        if opcode != INDEX:
            continue
        for at, mask in ((a, 1), (a, 8), (a + 1, 0x10), (a + 3, 1), (a + 8, 0x80)):
            book, found = read(tmp_path, flipped(content, at, mask))
            assert len(found) == COUNT
            assert book.finished
            assert not book.lost
            assert all("nothing of the flight is missing" in line for line in book.missing())
        break


def test_a_chunk_that_is_missing_without_a_trace_is_missed(tmp_path, content):
    table = chunks(content)
    a, b = table[7][0], table[8][0]
    book, found = read(tmp_path, content[:a] + content[b:])
    assert len(found) == COUNT - 4
    assert book.missing()[0].endswith("(0.27 s to 0.32 s) are missing, 4 messages")


def test_a_replay_ends_where_the_damage_begins(tmp_path, content):
    table = chunks(content)
    book, _ = read(tmp_path, flipped(content, table[10][1] - 3, 1))
    rows = list(before_damage(LogReader(book.path)))
    assert [row.stamp for row in rows] == [k * 10**7 for k in range(40)]
    read(tmp_path, flipped(content, table[0][1] - 3, 1))
    with pytest.raises(LogError, match="damage before the first tick"):
        list(before_damage(LogReader(book.path)))


def test_a_small_file_cut_off_at_any_byte(tmp_path, content):
    end = chunks(content)[3][1]
    for length in range(end):
        book, found = read(tmp_path, content[:length])
        assert found == [k * 10**7 for k in range(len(found))]
        assert not book.finished
        assert book.missing() == []


def test_a_log_that_grows_behind_damage_is_read_on(tmp_path, content):
    table = chunks(content)
    hurt = flipped(content, table[10][1] - 3, 1)
    path = tmp_path / "log.mcap"
    path.write_bytes(hurt[: table[10][1]])
    book = LogReader(path)
    assert len(list(book.read())) == 40
    assert len(book.missing()) == 1
    path.write_bytes(hurt[: table[12][1]])
    assert [row.stamp for row in book.read()] == [k * 10**7 for k in range(44, 52)]
    path.write_bytes(hurt)
    assert len(list(book.read())) == COUNT - 52
    assert book.finished
    assert "0.05 s of flight" in "".join(book.missing())


# Made by hand


def rec(opcode: int, body: bytes) -> bytes:
    return HEAD.pack(opcode, len(body)) + body


def text(word: str) -> bytes:
    return struct.pack("<I", len(word)) + word.encode()


def header(library: str = "airbearing-testbed") -> bytes:
    return rec(1, text("") + text(library))


def names() -> bytes:
    schema = rec(3, struct.pack("<H", 1) + text("Truth") + text("jsonschema") + text("{}"))
    return schema + rec(4, struct.pack("<HH", 1, 1) + text("/truth") + text("json") + bytes(4))


def message(sequence: int) -> bytes:
    return rec(5, struct.pack("<HIQQ", 1, sequence, sequence, 0) + b"{}")


def packed(
    data: bytes, size: int | None = None, crc: int | None = None, frame: bytes = b"",
    compression: str = "zstd",
) -> bytes:  # fmt: skip
    """A chunk."""
    frame = frame or (zstandard.compress(data) if compression == "zstd" else data)
    size = len(data) if size is None else size
    crc = zlib.crc32(data) if crc is None else crc
    head = struct.pack("<QQQI", 0, 1, size, crc) + text(compression)
    return rec(6, head + struct.pack("<Q", len(frame)) + frame)


GOOD = names() + message(1)
END = rec(15, bytes(4)) + rec(2, bytes(20)) + MAGIC


@pytest.mark.parametrize("compression", ["zstd", ""])
def test_a_chunk_made_by_hand_is_read(tmp_path, compression):
    book, found = read(tmp_path, MAGIC + header() + packed(GOOD, compression=compression) + END)
    assert (found, book.complete(), book.missing()) == ([1], True, [])


def test_a_log_of_other_software_need_not_be_numbered(tmp_path):
    first, second = packed(names() + message(7)), packed(message(7))
    book, found = read(tmp_path, MAGIC + header("mcap-go") + first + second + END)
    assert (found, book.missing()) == ([7, 7], [])


@pytest.mark.parametrize("content", [b"", MAGIC[:3], MAGIC, MAGIC + header(), MAGIC + END])
def test_an_empty_log_is_a_log(tmp_path, content):
    book, found = read(tmp_path, content)
    assert (found, book.missing()) == ([], [])


@pytest.mark.parametrize("seed", range(5))
def test_random_bytes_are_no_log(tmp_path, seed):
    noise = np.random.default_rng(seed).bytes(20_000)
    with pytest.raises(LogError, match="an MCAP file"):
        read(tmp_path, noise)
    _, found = read(tmp_path, MAGIC + noise)
    assert found == []


def huge_frame(size: int) -> bytes:
    """The beginning of a zstd frame that says how long it is."""
    return zstandard.compress(b"")[:4] + b"\xe0" + struct.pack("<Q", size) + b"\1\0\0"


BOMBS = {
    "a gigabyte of zeros": packed(b"", 2**30, 0, huge_frame(2**30)),
    "more than any memory": packed(b"", 2**62, 0, huge_frame(2**62)),
    "many chunks": packed(GOOD + message(1) * 200_000) * 40,
}


@pytest.mark.parametrize("bomb", BOMBS.values(), ids=BOMBS.keys())
def test_a_log_that_unpacks_to_far_too_much_is_refused(tmp_path, bomb):
    with pytest.raises(LogError, match="expected  chunks of at most 8 MB, and a log of at most 64"):
        read(tmp_path, MAGIC + header() + bomb + END)


LIES = {
    "size of the frame": packed(GOOD, size=2**62),
    "size of the chunk": packed(GOOD, size=3),
    "checksum": packed(GOOD, crc=1),
    "compression": packed(GOOD, compression="zstd", frame=b"none of it"),
    "another compression": packed(GOOD, compression="rar"),
    "no beginning": rec(6, bytes(10)),
    "a message longer than its chunk": packed(names() + HEAD.pack(5, 2**40)),
    "a message without a beginning": packed(names() + rec(5, b"{}")),
    "half a record": packed(names() + b"\5\0\0"),
    "no record": packed(names() + rec(0, b"")),
    "a name longer than its record": packed(rec(3, struct.pack("<HI", 1, 2**31) + b"Truth")),
    "a name that is no text": packed(rec(3, struct.pack("<HI", 1, 2) + b"\xff\xfe")),
    "a metadata map without end": packed(
        rec(4, struct.pack("<HH", 1, 1) + text("/t") + text("json") + struct.pack("<I", 2**31))
    ),
}


@pytest.mark.parametrize("lie", LIES.values(), ids=LIES.keys())
def test_a_chunk_that_lies_is_passed_over_as_a_whole(tmp_path, lie):
    book, found = read(tmp_path, MAGIC + header() + lie + packed(names() + message(2)) + END)
    assert found == [2]
    assert f"damaged at byte {len(MAGIC + header())}" in book.missing()[0]
    assert book.missing()[0].endswith("are missing, 1 message")


def test_a_file_full_of_what_looks_like_chunks_is_given_up(tmp_path):
    decoy = packed(bytes(2**20) * 6, crc=1)
    with pytest.raises(LogError, match="too much after it looks like a log"):
        read(tmp_path, MAGIC + header() + decoy * 100)


def test_many_places_are_said_in_few_lines(tmp_path):
    parts = [packed(names() + message(1)), *(packed(message(2 * k + 1)) for k in range(1, 60))]
    book, found = read(tmp_path, MAGIC + header() + b"\0".join(parts) + END)
    assert len(found) == 60
    assert len(book.missing()) == 11
    assert book.missing()[-1].endswith("is damaged in 49 more places")
