"""The operator at a terminal: asked, and believed only when the answer is yes."""

import os
import pty
import subprocess
import sys
from pathlib import Path

import pytest
from msgspec.structs import replace

from testbed.cli.operator import Operator
from testbed.config import ConfigError, find, load
from testbed.core.codes import FaultReport

ROOT = Path(__file__).resolve().parents[2]
ASK = "from testbed.cli.operator import Operator; print(Operator().agree(['sat1', 'sat2']))"


def answered(answer: bytes) -> tuple[str, str]:
    """What an operator at a terminal who types this has agreed to, and what was asked."""
    master, slave = pty.openpty()
    try:
        process = subprocess.Popen(
            [sys.executable, "-c", ASK], stdin=slave, stdout=subprocess.PIPE,
            stderr=subprocess.PIPE, text=True, cwd=ROOT,
        )  # fmt: skip
        os.write(master, answer)
        stdout, stderr = process.communicate(timeout=120)
    finally:
        os.close(slave)
        os.close(master)
    return stdout.rpartition("]: ")[2].strip(), stderr + stdout


@pytest.mark.parametrize(
    ("typed", "agreed"),
    [(b"y\n", "True"), (b"yes\n", "True"), (b"n\n", "False"), (b"\n", "False"), (b"\x04", "False")],
)
def test_only_yes_is_yes(typed, agreed):
    found, asked = answered(typed)
    assert found.endswith(agreed)
    assert "may sat1, sat2 be armed?" in asked


def test_a_script_says_it_with_a_flag():
    assert Operator(arm=True).agree(["sat1"])


def test_without_a_terminal_arming_is_declined(monkeypatch):
    monkeypatch.setattr(sys.stdin, "isatty", lambda: False, raising=False)
    assert not Operator().agree(["sat1"])
    with pytest.raises(ConfigError, match="--arm"):
        Operator().must_be_there("table")
    Operator().must_be_there("bench")  # nobody can be hurt
    Operator(arm=True).must_be_there("table")


def test_a_latched_fault_needs_an_operator_who_has_looked(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    monkeypatch.setattr(sys.stdin, "isatty", lambda: False, raising=False)
    experiment = load(find("hold"))
    latch, fault = Operator().latched("table", experiment, "runs/1")
    assert fault is None
    lost = FaultReport("pose_lost", "no pose", "sat1", "pose_age")
    latch.set(lost)
    with pytest.raises(ConfigError, match="--reset"):
        Operator().latched("table", experiment, "runs/2")
    assert Operator(reset=True).latched("table", experiment, "runs/2")[1] == replace(
        lost, notes=("in runs/1",)
    )
