"""Compiling for a wheel; tests/core/test_code_cache.py builds one."""

import subprocess

from testbed.config.shipped import shipped
from testbed.core.code_cache import source_digest
from testbed.run import machine_code


def flown(monkeypatch, codes):
    """Arguments and cache folders of the processes that it starts, which end with these codes."""
    found = []

    def run(words, env, **_):
        found.append((tuple(words[4:-2]), env["NUMBA_CACHE_DIR"]))
        return subprocess.CompletedProcess(words, codes.get(words[4], 0), stdout="what it said\n")

    monkeypatch.setattr(subprocess, "run", run)
    return found


def test_every_shipped_experiment_is_flown_and_the_bench(monkeypatch, tmp_path, capsys):
    found = flown(monkeypatch, {"zhang2023_table_lqr": 1, "zhang2023_table_pd": 3})  # as they do
    (lock := tmp_path / source_digest() / "a.lock").parent.mkdir()
    lock.touch()
    assert machine_code.main(tmp_path) == 0
    assert not lock.exists()
    names = [words[0] for words, _ in found if words[-1] == "twin"]
    assert sorted(names) == sorted(shipped("experiments"))
    assert [words[0] for words, _ in found if words[-1] == "bench"] == ["hold"]
    assert {folder for _, folder in found} == {str(tmp_path / source_digest())}
    assert capsys.readouterr().out.splitlines()[-1].endswith("hold on the bench")


def test_a_flight_that_fails_is_shown(monkeypatch, tmp_path, capsys):
    flown(monkeypatch, {"hold": 2})
    assert machine_code.main(tmp_path) == 1
    assert capsys.readouterr().err == "testbed run hold --rig twin:\nwhat it said\n"
