"""What a machine lacks is said before a run leaves anything behind."""

import sys

import pytest
from click.testing import CliRunner

from firmware_interface import compiler
from testbed.cli.main import BAD_INPUT, main
from testbed.core.extra import pip_install


@pytest.fixture(autouse=True)
def elsewhere(tmp_path, monkeypatch):
    folder = tmp_path / "here"
    folder.mkdir()
    monkeypatch.chdir(folder)
    return folder


@pytest.fixture
def no_compiler(tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.delenv("CC", raising=False)
    monkeypatch.setattr(compiler, "CACHE", tmp_path / "cache")


@pytest.mark.parametrize("board", ["model", "host", "qemu"])
def test_a_bench_without_a_compiler(no_compiler, elsewhere, board):
    done = CliRunner().invoke(main, ["run", "hold", "--rig", "bench", f'board="{board}"'])
    assert done.exit_code == BAD_INPUT
    assert "apt install" in done.output
    assert list(elsewhere.iterdir()) == []


def test_an_emulated_chip_without_its_emulator(monkeypatch, elsewhere):
    monkeypatch.setitem(sys.modules, "unicorn", None)
    monkeypatch.delitem(sys.modules, "firmware_interface.unicorn_board", raising=False)
    monkeypatch.delitem(sys.modules, "firmware_interface.stm32", raising=False)
    done = CliRunner().invoke(main, ["run", "hold", "board=unicorn"])
    assert done.exit_code == BAD_INPUT
    assert pip_install("emulator") in " ".join(done.output.split())
    assert list(elsewhere.iterdir()) == []
