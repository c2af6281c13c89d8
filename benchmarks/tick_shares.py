"""Shares of a flight's processor time by function: the compiled ones by name, by `perf`.

    python benchmarks/tick_shares.py [--experiment zhang2023_table] [--flights 8] [--least 0.5]

The flights are on the twin and in memory. `perf` of Linux samples this process (Debian:
`linux-perf`; as another user than root, /proc/sys/kernel/perf_event_paranoid must be 2 or less).
The names of compiled functions come from the object code that numba loads; a function that was
taken into its caller counts there. Functions of the heap, of mathematics and of Python are sums.
"""

import argparse
import os
import re
import shutil
import signal
import struct
import subprocess
import sys
import tempfile
from collections import Counter
from pathlib import Path
from typing import Any

from numba.core.codegen import CodeLibrary

FUNCTION = 2  # type of a symbol, and of the section of symbols
HEAP = re.compile(r"malloc|calloc|_int_free|cfree|NRT_|unlink_chunk")
MATHEMATICS = re.compile(r"pow|exp|log|sincos|sin_fma|cos_fma|atan|hypot|fmod|sqrt")
COPIES = re.compile(r"mem(cpy|set|move)")

loaded: list[tuple[Any, bytes]] = []  # libraries and their object code


def keep_object_code() -> None:
    """Keep what numba loads from its cache; before the first compiled function is imported."""
    inner = CodeLibrary._set_compiled_object

    def outer(library: Any, code: Any) -> None:
        loaded.append((library, bytes(code)))
        inner(library, code)

    CodeLibrary._set_compiled_object = outer


def functions_in(code: bytes) -> list[tuple[str, int, int, int]]:
    """Functions of an object file (ELF, 64 bits): name, section, place in it, size [bytes]."""
    (begin,) = struct.unpack_from("<Q", code, 0x28)
    size, count = struct.unpack_from("<HH", code, 0x3A)
    sections = [struct.unpack_from("<IIQQQQIIQQ", code, begin + k * size) for k in range(count)]
    found = []
    for _, kind, _, _, at, length, link, _, _, each in sections:
        if kind != FUNCTION:
            continue
        for k in range(length // each):
            symbol = struct.unpack_from("<IBBHQQ", code, at + k * each)
            name, info, _, section, place, extent = symbol
            if info & 15 == FUNCTION and extent:
                text = sections[link][4] + name
                word = code[text : code.index(b"\0", text)].decode()
                found.append((word, section, place, extent))
    return found


def plain(symbol: str) -> str:
    """`testbed.flight.window.listen` for numba's long symbol."""
    words, rest = [], symbol.removeprefix("_ZN")
    while match := re.match(r"\d+", rest):
        end = match.end() + int(match[0])
        words.append(rest[match.end() : end])
        rest = rest[end:]
    return ".".join(words) or symbol


def write_map() -> int:
    """Tell perf where the functions are in memory; returns how many are known."""
    lines = set()
    for library, code in loaded:
        functions, begins = functions_in(code), dict[int, int]()
        for name, section, place, _ in functions:
            if address := library.codegen._engine.get_function_address(name):
                begins.setdefault(section, address - place)
        for name, section, place, size in functions:
            if section in begins:
                lines.add(f"{begins[section] + place:x} {size:x} {plain(name)}\n")
    Path(f"/tmp/perf-{os.getpid()}.map").write_text("".join(sorted(lines)))
    return len(lines)


def shares_of(report: str) -> Counter[str]:
    """Shares in percent by function or by kind of function."""
    shares: Counter[str] = Counter()
    for line in report.splitlines():
        if line.startswith("#") or line.count(";") < 2:
            continue
        share, where, name = (word.strip() for word in line.split(";", 2))
        level, name = name[:3], name[4:].partition(";")[0].strip()
        if level == "[k]":
            kind = "the system"
        elif where.startswith("[JIT]"):
            kind = name if "." in name else "compiled, without a name"
        elif HEAP.search(name):
            kind = "the heap"
        elif COPIES.search(name):
            kind = "copies of memory"
        elif where.startswith("libm.") or MATHEMATICS.search(name):
            kind = "powers, exponentials, sines"
        else:
            kind = "Python, numpy, numba"
        shares[kind] += float(share.rstrip("%"))
    return shares


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--experiment", default="zhang2023_table")
    parser.add_argument("--flights", type=int, default=8)
    parser.add_argument("--least", type=float, default=0.5, help="smallest share printed [%%]")
    options = parser.parse_args()
    if shutil.which("perf") is None:
        sys.exit("perf is not installed (Debian: linux-perf)")
    keep_object_code()
    from testbed.config import find, load  # after numba's library has been changed
    from testbed.realtime.scheduling import steady_memory
    from testbed.rig.observers import MetricsObserver
    from testbed.rig.twin import make_twin

    experiment = load(find(options.experiment))

    def fly() -> None:
        rig, judge = make_twin(experiment), MetricsObserver(experiment.vehicles)
        with steady_memory():
            rig.fly(judge)

    fly()
    if not write_map():
        sys.exit("the code was compiled now, and it has no names: start this once more")
    with tempfile.TemporaryDirectory() as folder:
        data, pid = f"{folder}/perf.data", str(os.getpid())
        words = ["perf", "record", "-q", "-e", "cpu-clock", "-F", "4000", "-p", pid, "-o", data]
        with subprocess.Popen(words, stderr=subprocess.PIPE) as perf:
            for _ in range(options.flights):
                fly()
            perf.send_signal(signal.SIGINT)
            perf.communicate()
        words = ["perf", "report", "-i", data, "--stdio", "-t", ";", "--sort", "dso,symbol"]
        report = subprocess.run(words, capture_output=True, text=True, check=True).stdout
    Path(f"/tmp/perf-{pid}.map").unlink()
    shares = shares_of(report)
    modules: Counter[str] = Counter()
    for name, share in shares.items():
        modules[name.rpartition(".")[0] or name] += share
    for title, table in (("function", shares), ("module", modules)):
        print(f"\n  share  {title}")
        for name, share in table.most_common():
            if share >= options.least:
                print(f"{share:6.1f} %  {name}")


if __name__ == "__main__":
    main()
