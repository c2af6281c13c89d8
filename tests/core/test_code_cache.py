"""Processes that start together, and their compiled code on disk."""

import os
import subprocess
import sys

COUNT = """
import sys
from sim_twin.contact import keys
keys.targetctx.refresh()  # takes longer than to compile
print("ready", flush=True)
sys.stdin.readline()
keys(1, 2)
print(sum(keys.stats.cache_misses.values()), sum(keys.stats.cache_hits.values()))
"""


def without_code(folder):
    """Environment of a process whose cache is here."""
    environment = os.environ | {"NUMBA_CACHE_DIR": str(folder)}
    environment.pop("NUMBA_DISABLE_JIT", None)
    return environment


def test_one_compiles_for_all(tmp_path):
    started = [
        subprocess.Popen(
            [sys.executable, "-c", COUNT], env=without_code(tmp_path), text=True,
            stdin=subprocess.PIPE, stdout=subprocess.PIPE,
        )
        for _ in range(3)
    ]  # fmt: skip
    for one in started:
        assert one.stdout.readline() == "ready\n"
    for one in started:
        one.stdin.write("\n")
        one.stdin.flush()
    found = sorted(one.communicate(timeout=100)[0] for one in started)
    assert found == ["0 1\n", "0 1\n", "1 0\n"]


FAILS = """
import subprocess, sys
from numba.core.errors import TypingError
from sim_twin.contact import keys
try:
    keys("no", "number")
except TypingError:
    subprocess.run([sys.executable, "-c", sys.argv[1]], check=True, timeout=100)
"""


def test_a_function_that_cannot_be_compiled_is_left_to_others(tmp_path):
    """This process lives on while another one compiles the function."""
    found = subprocess.run(
        [sys.executable, "-c", FAILS, COUNT], env=without_code(tmp_path), input="\n",
        check=True, timeout=200, stdout=subprocess.PIPE, text=True,
    )  # fmt: skip
    assert found.stdout == "ready\n1 0\n"
