"""Processes that start together, and their compiled code on disk."""

import os
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

from testbed.core import code_cache

ROOT = Path(__file__).resolve().parents[2]

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


COMPILE = """
from sim_twin.contact import keys
keys(1, 2)
print(sum(keys.stats.cache_misses.values()), sum(keys.stats.cache_hits.values()))
"""


def compiled_from(tree, cache, program=COMPILE):
    """What a process prints that runs this tree's code, with its cache here."""
    environment = os.environ | {"PYTHONPATH": str(tree), "XDG_CACHE_HOME": str(cache)}
    for name in ("NUMBA_CACHE_DIR", "NUMBA_DISABLE_JIT"):
        environment.pop(name, None)
    found = subprocess.run(
        [sys.executable, "-c", program], env=environment, cwd=tree, check=True, timeout=100,
        stdout=subprocess.PIPE, text=True,
    )  # fmt: skip
    return found.stdout.strip()


@pytest.fixture(scope="module")
def installed(tmp_path_factory):
    """What a wheel with machine code of one function installs; it was compiled somewhere else."""
    here = tmp_path_factory.mktemp("wheel")
    source = here / "source"
    names = ("testbed", "controllers", "sim_twin", "firmware_interface", "configs")
    for name in names:
        shutil.copytree(ROOT / name, source / name, ignore=shutil.ignore_patterns("__pycache__"))
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, source / name)
    assert compiled_from(source, here / "cache") == "1 0"
    shutil.copytree(here / "cache" / "airbearing-testbed", source / "testbed" / "machine_code")
    subprocess.run(
        [sys.executable, "-m", "pip", "wheel", "-q", "--no-deps", "--no-build-isolation",
         "-w", here, source], check=True, timeout=100,
    )  # fmt: skip
    wheel = next(here.glob("*.whl"))
    zipfile.ZipFile(wheel).extractall(here / "site")
    return here / "site"


def test_code_in_a_wheel_is_used(installed, tmp_path):
    assert compiled_from(installed, tmp_path) == "0 1"
    assert not list(tmp_path.rglob("*.nbc"))


def test_code_in_a_wheel_serves_many_processors_on_x86(installed):
    kinds = {p.read_bytes().count(b"x86-64-v3") for p in installed.rglob("*.nbi")}
    assert kinds == {1 if code_cache._processor() else 0}


def test_code_in_a_wheel_is_not_used_after_an_edit(installed, tmp_path):
    tree = shutil.copytree(installed, tmp_path / "edited")
    with (tree / "sim_twin" / "air.py").open("a") as file:
        file.write("# another line\n")
    assert compiled_from(tree, tmp_path / "cache") == "1 0"


def test_two_clones_share_their_code(installed, tmp_path):
    """A function is found by its module, not by the path of its file."""
    for name, found in (("one", "1 0"), ("two", "0 1")):
        tree = shutil.copytree(installed, tmp_path / name)
        shutil.rmtree(tree / "testbed" / "machine_code")
        assert compiled_from(tree, tmp_path / "cache") == found


VARIOUS = """
import numpy as np
from testbed.core.compiled import compiled

@compiled
def root(x):
    if x < 0:
        raise ValueError("negative")
    return np.sqrt(x)

@compiled
def various(x, n):
    a = np.zeros(3)
    a[:] = np.full(n, root(x))
    np.random.seed(1)
    return {"a": a}["a"], np.random.random(), hash((n, x)), f"{n} numbers"

@compiled
def solved(a, b):
    return np.linalg.solve(a, b) @ a
"""
CALL = """
import sys
import numpy as np
from controllers.various import solved, various
for args in ((2.0, 3), (-1.0, 3), (2.0, 4)):
    try:
        print(*various(*args))
    except ValueError as error:
        print(error)
before = "scipy.linalg" in sys.modules
print(solved(np.diag([2.0, 4.0]), np.ones(2)))
misses = sum(f.stats.cache_misses.total() for f in (various, solved))
print(misses, before, "numba.np.polynomial" in sys.modules)
"""


def test_code_that_is_found_needs_nothing_that_compiles(installed, tmp_path):
    """It allocates, raises, hashes and solves as it did where it was compiled."""
    tree = shutil.copytree(installed, tmp_path / "tree")
    (tree / "controllers" / "various.py").write_text(VARIOUS)
    *first, how = compiled_from(tree, tmp_path / "cache", CALL).splitlines()
    assert how == "2 False True"
    *again, how = compiled_from(tree, tmp_path / "cache", CALL).splitlines()
    assert how == "0 False False"
    assert again == first
    assert "negative" in first


NAMES = """
from numba.core.bytecode import FunctionIdentity
from testbed.core import code_cache
import os
def of(gains): return gains
child = os.fork()
os.write(1, FunctionIdentity.from_function(of).unique_name.encode() + b"\\n")  # a line at once
if child:
    os.waitpid(child, 0)
"""


def test_processes_give_their_code_different_names():
    """One that loads the code of two laws would otherwise fly the first for both."""
    words = [sys.executable, "-c", NAMES]
    found = [subprocess.check_output(words, text=True, timeout=100) for _ in range(2)]
    names = "".join(found).splitlines()
    assert len(names) == len(set(names)) == 4
