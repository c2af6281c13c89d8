"""Compiles what the shipped experiments need into a folder, which a wheel can bring along.

    python -m testbed.run.machine_code FOLDER

`make wheel` puts the folder into the wheel as `testbed/machine_code`, where core/code_cache.py
looks before it compiles. The code fits one minor version of Python, one version of numba and, on
x86, all processors with AVX2; elsewhere it is not used, and the first flight compiles.
"""

import os
import subprocess
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from testbed.config.shipped import shipped
from testbed.core.code_cache import source_digest

BENCH = ("hold", "duration_s=1.0", "--rig", "bench")  # cameras and filter in processes of their own
FLOWN = (0, 1, 3)  # exit codes: laws that are blind to obstacles fail or are stopped


def flights() -> list[tuple[str, ...]]:
    """Arguments of `testbed run` that together compile all that the shipped laws need."""
    return [*((name, "--rig", "twin") for name in shipped("experiments")), BENCH]


def fly(words: tuple[str, ...], folder: Path) -> str:
    """Fly with compiled code in `folder`; returns what went wrong, or nothing."""
    environment = os.environ | {"NUMBA_CACHE_DIR": str(folder.absolute())}
    with tempfile.TemporaryDirectory() as run:
        done = subprocess.run(
            [sys.executable, "-m", "testbed", "run", *words, "--out", f"{run}/flight"],
            env=environment, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
        )  # fmt: skip
    return "" if done.returncode in FLOWN else f"testbed run {' '.join(words)}:\n{done.stdout}"


def main(folder: Path) -> int:
    """Fly everything; 1 if a flight failed, with its output on stderr."""
    folder /= source_digest()
    todo, done = flights(), 0
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        for words, wrong in zip(todo, pool.map(lambda one: fly(one, folder), todo), strict=True):
            if wrong:
                pool.shutdown(cancel_futures=True)
                sys.stderr.write(wrong)
                return 1
            done += 1
            sys.stdout.write(f"{done} of {len(todo)}: {words[0]} on the {words[-1]}\n")
            sys.stdout.flush()
    for lock in folder.rglob("*.lock"):
        lock.unlink()
    return 0


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1])))
