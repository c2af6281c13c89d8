"""Processes that compile beside the first flight."""

import os

import pytest
from msgspec.structs import replace

from controllers.own_law import OwnLawParams
from testbed.config import find, load
from testbed.rig import ahead
from testbed.rig.fleet.host import TwinHost


@pytest.mark.parametrize("name", ["hold", "zhang2023_table", "zhang2023_table_wrench"])
def test_each_part_runs(name):
    """In this process: its code is compiled by now."""
    for part in ahead.PARTS.values():
        part(load(find(name)))


def test_the_laws_part_compiles_the_tick_of_the_flight(monkeypatch):
    """A part that stopped before it would still run, and save nothing."""
    found, tick = [], TwinHost._compiled_tick

    def noted(host, t):
        found.append(tick(host, t))
        return found[-1]

    monkeypatch.setattr(TwinHost, "_compiled_tick", noted)
    ahead.law(load(find("zhang2023_table")))
    assert found[-1] is not None


@pytest.fixture
def started(monkeypatch):
    found = []
    start = ahead._start
    monkeypatch.setattr(ahead, "_start", lambda *one: found.append(start(*one)) or found[-1])
    return found


def test_no_process_is_left(started, monkeypatch):
    monkeypatch.setattr(ahead, "_is_worth_it", lambda: True)
    with ahead.compiling_ahead(load(find("hold"))):
        assert len(started) == 2
    assert all(one.returncode is not None for one in started)


def test_none_is_started_where_it_would_not_help(started, monkeypatch, tmp_path):
    experiment, cache = load(find("hold")), vars(ahead.config)
    monkeypatch.setitem(cache, "CACHE_DIR", str(tmp_path))
    monkeypatch.setattr(os, "cpu_count", lambda: 4)
    for load_now, done in ((3.5, False), (0.0, True)):
        monkeypatch.setattr(os, "getloadavg", lambda now=load_now: (now, now, now))
        if done:
            (tmp_path / "chain.step-1.py311.nbi").touch()
        with ahead.compiling_ahead(experiment):
            assert not started
    (tmp_path / "chain.step-1.py311.nbi").unlink()
    assert ahead._is_worth_it()


def test_a_users_law_runs_in_the_flights_process_only():
    experiment = load(find("hold"))
    assert ahead._is_ours(experiment)
    assert not ahead._is_ours(replace(experiment, controller=OwnLawParams("mine.py:Mine")))
