"""Put small faults into the port of the board's chip, and see whether `port_check` notices them.

    python tests/firmware/port_mutation.py [--every N] [--first K]

Each fault is built into an image of its own. A survivor whose machine code is the same does not
count; all others count against the score. Survivors are printed. One that port_survivors.toml does
not explain makes the run fail.
"""

import argparse
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import tomllib
from collections import Counter
from functools import cache
from pathlib import Path

from board_limits import LIMITS
from mutants import Mutant, places
from mutants import line_with as line_of
from port_check import wrong_with
from port_inside import PROBES

from firmware_interface.compiler import CHIP_FLAGS, CORE, FIRMWARE, cross_compiler
from firmware_interface.limits import board_header

CHIP = FIRMWARE / "stm32f4"
SOURCES = ("startup.c", "main.c", "timer_tim2.c", "timer.h", "board.h", "registers.h")
UNUSED = "SYSTICK", "SCB_"  # names that only QEMU's timer uses
LIMIT_S = 10  # of CPU for one fault; the check of a sound image takes 0.7 s
SURVIVORS = tomllib.loads((Path(__file__).parent / "port_survivors.toml").read_text())["survivor"]
NAMES = ("file", "function", "was", "now")
LEAST = 90  # of faults noticed, of the whole set [%]
# the port has no variable with a value, so that boot would have nothing to copy
TOLD = f"unsigned told[] = {{{', '.join(map(str, PROBES))}}};"
OUTCOMES = ("survived", "noticed", "same_code", "not_built")


def port_mutants() -> list[Mutant]:
    """Every fault of the port."""
    found = []
    for name in SOURCES:
        code = (CHIP / name).read_bytes()
        for begin, end, text, function in places(CHIP / name):
            was, now = line_of(code, begin, end, text)
            if was != now and not any(word in was for word in UNUSED):
                found.append(Mutant(CHIP / name, begin, end, text, function, was, now))
    return found


@cache
def core_objects() -> tuple[tempfile.TemporaryDirectory[str], list[str]]:
    """The core, compiled once: it includes nothing of the port."""
    place = tempfile.TemporaryDirectory()
    flags = ["-std=c99", "-w", *CHIP_FLAGS, f"-I{FIRMWARE / 'core'}", "-c"]
    objects = [f"{place.name}/{source.stem}.o" for source in CORE]
    for source, target in zip(CORE, objects, strict=True):
        subprocess.run([cross_compiler(), *flags, str(source), "-o", target], check=True)
    return place, objects


def built(folder: Path, mutant: Mutant | None) -> bytes | None:
    """The image with a fault in it; None if it does not compile."""
    chip = folder / "chip"
    shutil.copytree(CHIP, chip, dirs_exist_ok=True)
    if mutant is not None:
        (chip / mutant.source.name).write_bytes(mutant.mutated())
    (folder / "abt_board_config.h").write_text(board_header(LIMITS))
    (folder / "told.c").write_text(TOLD)
    flags = [flag for flag in CHIP_FLAGS if flag != "-g"]
    sources = [chip / name for name in ("startup.c", "main.c", "timer_tim2.c")]
    command = [
        cross_compiler(), "-std=c99", "-w", *flags, f"-I{FIRMWARE / 'core'}", f"-I{chip}",
        f"-I{folder}", f"-T{CHIP / 'stm32f405.ld'}", "-DABT_FIRMWARE_ID=1u", *map(str, sources),
        "-Wl,-u,told", str(folder / "told.c"), *core_objects()[1], "-lgcc", "-o",
        str(folder / "elf"),
    ]  # fmt: skip
    if subprocess.run(command, capture_output=True, check=False).returncode:
        return None
    flat = ["arm-none-eabi-objcopy", "-O", "binary", str(folder / "elf"), str(folder / "bin")]
    subprocess.run(flat, check=True)
    return (folder / "bin").read_bytes()


def outcome_of(mutant: Mutant | None, healthy: bytes | None) -> str:
    """What became of one fault."""
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        code = built(folder, mutant)
        if code is None:
            return "not_built"
        if code == healthy:
            return "same_code"
        try:
            return "noticed" if wrong_with(folder / "bin") else "survived"
        except Exception:  # a broken image breaks the emulator in any way
            return "noticed"


def tried(mutant: Mutant, healthy: bytes) -> str:
    """The same in a process of its own, which a fault may hang."""
    child = os.fork()
    if child == 0:
        signal.setitimer(signal.ITIMER_PROF, LIMIT_S)  # its signal ends the process
        os._exit(OUTCOMES.index(outcome_of(mutant, healthy)))
    _, status = os.waitpid(child, 0)
    return "noticed" if os.WIFSIGNALED(status) else OUTCOMES[os.WEXITSTATUS(status)]


def main() -> int:
    """Try the faults, print survivors and the score."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--every", type=int, default=1)
    parser.add_argument("--first", type=int, default=0)
    options = parser.parse_args()
    faults = port_mutants()[options.first :: options.every]
    with tempfile.TemporaryDirectory() as place:
        healthy = built(Path(place), None)
        assert healthy is not None
        wrong = wrong_with(Path(place) / "bin")
    if wrong:
        print(f"the image as it is: {wrong}")  # noqa: T201
        return 1
    counts: Counter[str] = Counter()
    explained = {tuple(one[name] for name in NAMES) for one in SURVIVORS}
    unexplained = 0
    for fault in faults:
        what = tried(fault, healthy)
        counts[what] += 1
        if what == "survived":
            name = fault.source.name, fault.function, fault.was, fault.now
            unexplained += name not in explained
            print(f"{fault.source.name} {fault.function}: {fault.was}  ->  {fault.now}", flush=True)  # noqa: T201
    judged = counts["noticed"] + counts["survived"]
    print(dict(counts), f"{100.0 * counts['noticed'] / max(judged, 1):.1f} %")  # noqa: T201
    few = options.every == 1 and 100 * counts["noticed"] < LEAST * judged
    return int(unexplained > 0 or few)


if __name__ == "__main__":
    sys.exit(main())
