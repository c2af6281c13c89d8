"""Share of a damaged log that the reader recovers.

    python benchmarks/damaged_logs.py [--each 200] [--commands 10] [--seed 0] [--experiment NAME]

One run, then `each` damaged copies of each of three kinds: everything from a random byte on zeroed,
as after a power loss; 4 kB zeroed at a random place; one bit flipped. Every copy is read: errors
that no verb expects, untouched chunks that were read, losses that were not said, seconds of the
slowest. `commands` of each kind go through the verbs themselves, each in a process of its own: exit
codes, and whether a verb that went on has said what is missing.
"""

import argparse
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from testbed.logs.log_reader import LogError, LogReader
from testbed.logs.mcap_record import HEAD, Channel, Message, read_chunk

TESTBED = [sys.executable, "-m", "testbed"]
KINDS = ("zeroed tail", "4 kB zeroed", "one bit flipped")
VERBS = (
    ["log"], ["log", "--json"], ["replay"], ["report"], ["compare"],
    ["export", "--to", "csv"], ["export", "--to", "bag"], ["export", "--to", "rrd"],
)  # fmt: skip
LIMIT_S = 120.0  # of a verb, on a busy machine

Seen = tuple[str, bytes]  # topic and data of a message


def damaged(content: bytes, kind: str, rng: np.random.Generator) -> bytes:
    """A copy with one damage of this kind."""
    copy = bytearray(content)
    if kind == "zeroed tail":
        at = int(rng.integers(len(copy)))
        copy[at:] = bytes(len(copy) - at)
    elif kind == "4 kB zeroed":
        at = int(rng.integers(max(1, len(copy) - 4096)))
        copy[at : at + 4096] = bytes(len(copy[at : at + 4096]))
    else:
        copy[int(rng.integers(len(copy)))] ^= 1 << int(rng.integers(8))
    return bytes(copy)


def chunks(content: bytes) -> Iterator[tuple[int, int, list[Seen]]]:
    """Beginning, end and messages of every chunk of a whole log."""
    at, topics = 8, {}
    while at < len(content) - 8:
        opcode, length = HEAD.unpack_from(content, at)
        end = at + HEAD.size + length
        if opcode == 6:
            found = []
            for one in read_chunk(content[at + HEAD.size : end], 2**30):
                if isinstance(one, Channel):
                    topics[one.number] = one.topic
                if isinstance(one, Message):
                    found.append((topics[one.channel], one.data))
            yield at, end, found
        at = end


def read_copies(content: bytes, folder: Path, each: int, rng: np.random.Generator) -> bool:
    """Print a line for each kind; whether all was as it should be."""
    table, path, good = list(chunks(content)), folder / "damaged.mcap", True
    total = len({row for *_, rows in table for row in rows})
    print(f"{len(content) / 1e6:.2f} MB, {len(table)} chunks, {total} messages; {each} copies each")
    print(
        "kind             refused  wrong errors  untouched chunks read  lost  unsaid  slowest [s]"
    )
    for kind in KINDS:
        counts, slowest = Counter(), 0.0
        for _ in range(each):
            copy = damaged(content, kind, rng)
            path.write_bytes(copy)
            untouched = [rows for a, b, rows in table if copy[a:b] == content[a:b]]
            began, seen, said = time.perf_counter(), set(), True
            try:
                book = LogReader(path)
                seen = {(topic, data) for topic, _, data in book.read()}
                said = bool(book.missing())
            except LogError:
                counts["refused"] += 1
            except Exception as error:  # what would be exit code 70
                counts["wrong"] += 1
                print(f"  {kind}: {type(error).__name__}: {error}")
            slowest = max(slowest, time.perf_counter() - began)
            counts["there"] += len(untouched)
            counts["read"] += sum(seen.issuperset(rows) for rows in untouched)
            counts["lost"] += len(seen) < total
            counts["unsaid"] += len(seen) < total and not said
        chunks_read = f"{counts['read']} / {counts['there']}"
        print(
            f"{kind:16} {counts['refused']:7} {counts['wrong']:13} {chunks_read:>22}"
            f" {counts['lost']:5} {counts['unsaid']:7} {slowest:12.2f}"
        )
        good &= counts["wrong"] == counts["unsaid"] == 0 and counts["read"] == counts["there"]
    return good


def through_verbs(run: Path, folder: Path, count: int, rng: np.random.Generator) -> bool:
    """Print exit codes of the verbs; whether all was as it should be."""
    content, good = (run / "log.mcap").read_bytes(), True
    codes: dict[tuple[str, str], Counter[str]] = {}
    for kind in KINDS:
        for k in range(count):
            copy = folder / f"{kind} {k}"
            copy.mkdir()
            for name in ("config.toml", "metrics.json"):
                if name == "config.toml" or k % 2:  # a flight that lost power was not judged
                    (copy / name).write_bytes((run / name).read_bytes())
            (copy / "log.mcap").write_bytes(damaged(content, kind, rng))
            book = LogReader(copy / "log.mcap")
            for _ in book.read():
                pass
            for verb, *options in VERBS:
                heading = " ".join([verb, *options])
                count_of = codes.setdefault((kind, heading), Counter())
                try:
                    done = subprocess.run(
                        [*TESTBED, verb, str(copy), *options],
                        capture_output=True, text=True, timeout=LIMIT_S, check=False,
                    )  # fmt: skip
                except subprocess.TimeoutExpired:
                    count_of["hangs"] += 1
                    good = False
                    continue
                count_of[f"exit {done.returncode}"] += 1
                if done.returncode not in (0, 2):
                    good = False
                    print(f"  {kind} {k}, {heading}: {(done.stderr or done.stdout).strip()[-300:]}")
                if book.lost and done.returncode == 0 and "damaged" not in done.stderr:
                    good = False
                    count_of["unsaid"] += 1
    for (kind, heading), count_of in codes.items():
        said = ", ".join(f"{word}: {number}" for word, number in sorted(count_of.items()))
        print(f"{kind:16} {heading:16} {said}")
    return good


def main() -> int:
    """1 if anything was not as it should be."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--each", type=int, default=200)
    parser.add_argument("--commands", type=int, default=10)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--experiment", default="zhang2023_table")
    parser.add_argument("--seconds", type=float, default=40.0, help="of the run")
    args = parser.parse_args()
    rng = np.random.default_rng(args.seed)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        run = folder / "run"
        subprocess.run(
            [
                *(*TESTBED, "run", args.experiment, f"duration_s={args.seconds}"),
                *("--speed", "20", "--out", str(run)),  # a chunk for each tick, as in real time
            ],
            check=False, capture_output=True,
        )  # fmt: skip
        good = read_copies((run / "log.mcap").read_bytes(), folder, args.each, rng)
        good &= through_verbs(run, folder, args.commands, rng)
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
