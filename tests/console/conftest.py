"""A run to look at, Chromium, and the page's process."""

import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from types import ModuleType

import pytest

from chromium import chromium

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="session")
def browser() -> ModuleType:
    """The module that drives Chromium."""
    return chromium()


@pytest.fixture
def testbed(tmp_path) -> Iterator[Callable[..., subprocess.Popen[str]]]:
    """Start the command in a process of its own, with notes of its own."""
    started: list[subprocess.Popen[str]] = []

    def start(*words: str | Path) -> subprocess.Popen[str]:
        one = subprocess.Popen(
            [sys.executable, "-m", "testbed", *map(str, words)],
            cwd=ROOT, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE,
            text=True, env=os.environ | {"PYTHONPATH": str(ROOT), "XDG_RUNTIME_DIR": str(tmp_path),
                                         "XDG_STATE_HOME": str(tmp_path / "state")},
        )  # fmt: skip
        started.append(one)
        return one

    yield start
    for one in started:
        one.kill()
        one.communicate()


@pytest.fixture(scope="session")
def flown(tmp_path_factory) -> dict[str, Path]:
    """A flight of three vehicles, one with a fault, and one that was not started."""
    folder = tmp_path_factory.mktemp("flown")
    stuck = 'inject=[{kind="stick_open",vehicle="sat3",at_s=2.03,jet=3}]'
    for name, code, words in (
        ("three", 1, ["zhang2023_table", "duration_s=12"]),
        ("stuck", 3, ["zhang2023_table", "duration_s=8", stuck]),
        ("red", 4, ["zhang2023_table", "duration_s=8", "arming.battery=13"]),
    ):
        ended = subprocess.run(
            [sys.executable, "-m", "testbed", "run", *words, "--out", str(folder / name)],
            cwd=ROOT, capture_output=True, check=False,
            env=os.environ | {"PYTHONPATH": str(ROOT)},
        )  # fmt: skip
        assert ended.returncode == code, ended.stderr.decode()
    return {path.name: path for path in folder.iterdir()}


@pytest.fixture
def pictures(tmp_path) -> Path:
    """Where pictures go: DASHBOARD_PICTURES, to be looked at, or nowhere."""
    folder = Path(os.environ.get("DASHBOARD_PICTURES", tmp_path))
    folder.mkdir(parents=True, exist_ok=True)
    return folder
