"""Every line of the core runs in the tests, and no random session breaks an invariant."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from firmware_interface.compiler import CORE, FIRMWARE, WARNINGS, build, compiler

HERE = Path(__file__).parent
ROOT = HERE.parents[1]


def run(*command, **options):
    result = subprocess.run(
        [str(c) for c in command], capture_output=True, text=True, check=False, **options
    )
    assert result.returncode == 0, result.stdout + result.stderr
    return result.stdout


def test_half_a_million_random_frames_keep_the_invariants():
    flags = ("-O1", "-g", "-fsanitize=address,undefined", "-fno-sanitize-recover=all")
    program = build((*CORE, FIRMWARE / "test" / "fuzz.c"), flags, "")
    seed = os.environ.get("ABT_ROUND", "1")  # of `make fuzz`
    opened = re.search(r"500000 frames, (\d+) us open", run(program, 500_000, seed))
    assert int(opened[1]) > 100_000_000  # it did something


def test_every_line_of_the_core_is_run(tmp_path, need_tool):
    need_tool(None if shutil.which("gcov") else "gcov is not installed")
    library = tmp_path / "covered.so"
    flags = [flag for flag in WARNINGS if flag != "-Werror"]
    sources = (*CORE, FIRMWARE / "host" / "inproc.c")
    run(
        compiler(), *flags, "-O0", "-g", "--coverage", "-shared", "-fPIC", *sources,
        "-o", library, cwd=tmp_path,
    )  # fmt: skip
    tests = [HERE / f"test_{name}.py" for name in ("behaviour", "line", "finer_points")]
    run(
        sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", *tests,
        cwd=ROOT, env=os.environ | {"ABT_LIBRARY": str(library), "PYTHONPATH": str(ROOT)},
    )  # fmt: skip
    missed = []
    for source in CORE:
        run("gcov", "-o", tmp_path, next(tmp_path.glob(f"*{source.stem}.gcda")), cwd=tmp_path)
        report = (tmp_path / f"{source.name}.gcov").read_text()
        missed += [f"{source.name} {line}" for line in report.splitlines() if "#####:" in line]
    assert missed == []


@pytest.mark.parametrize("word", ["malloc", "memcpy", "printf", "<string.h>", "<stdlib.h>"])
def test_the_core_needs_no_libc(word):
    for source in (FIRMWARE / "core").iterdir():
        assert word not in source.read_text(), source.name
