"""A short run to look at, and what draws it without a screen."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]


def testbed(*words: str | Path) -> subprocess.Popen[bytes]:
    """The command, in a process of its own."""
    return subprocess.Popen(
        [sys.executable, "-m", "testbed", *map(str, words)],
        cwd=ROOT, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
    )  # fmt: skip


@pytest.fixture(scope="session")
def run(tmp_path_factory) -> Path:
    """Three satellites and two obstacles, for three seconds."""
    folder = tmp_path_factory.mktemp("looked-at") / "run"
    assert testbed("run", "zhang2023_table", "duration_s=3", "--out", folder).wait(300) == 1
    return folder


@pytest.fixture(scope="session")
def flown(tmp_path_factory) -> dict[str, Path]:
    """A flight with an obstacle that moves, and one in which a valve of sat3 stays open."""
    folder = tmp_path_factory.mktemp("flown")
    stuck = 'inject=[{kind="stick_open",vehicle="sat3",at_s=2.03,jet=3}]'
    moving = testbed("run", "xue2021_table_dynamic", "duration_s=6", "--out", folder / "moving")
    assert moving.wait(600) == 1
    fault = testbed("run", "zhang2023_table", "duration_s=8", stuck, "--out", folder / "stuck")
    assert fault.wait(600) == 3
    return {name: folder / name for name in ("moving", "stuck")}


@pytest.fixture
def pictures(tmp_path) -> Path:
    """Where pictures go: DASHBOARD_PICTURES, to be looked at, or nowhere."""
    folder = Path(os.environ.get("DASHBOARD_PICTURES", tmp_path))
    folder.mkdir(parents=True, exist_ok=True)
    return folder
