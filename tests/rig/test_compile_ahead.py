"""Processes that compile beside the first flight."""

import os

import pytest
from msgspec.structs import replace

from controllers.own_law import OwnLawParams
from testbed.config import find, load
from testbed.rig import compile_ahead
from testbed.rig.compile_ahead import compiling_ahead
from testbed.rig.fleet.host import TwinHost


@pytest.mark.parametrize("name", ["hold", "zhang2023_table", "zhang2023_table_wrench"])
def test_each_part_runs(name):
    """In this process: its code is compiled by now."""
    for part in (compile_ahead.act, *compile_ahead.PARTS.values()):
        part(load(find(name)))


def test_the_laws_part_compiles_the_tick_of_the_flight(monkeypatch):
    """A part that stopped before it would still run, and save nothing."""
    found, tick = [], TwinHost._compiled_tick

    def noted(host, t):
        found.append(tick(host, t))
        return found[-1]

    monkeypatch.setattr(TwinHost, "_compiled_tick", noted)
    compile_ahead.law(load(find("zhang2023_table")))
    assert found[-1] is not None


@pytest.fixture
def started(monkeypatch):
    found = []
    start = compile_ahead._start
    monkeypatch.setattr(
        compile_ahead, "_start", lambda *one: found.append(start(*one)) or found[-1]
    )
    return found


@pytest.fixture
def cache(monkeypatch, tmp_path):
    """An empty folder for compiled code, on a machine with four cores."""
    monkeypatch.setitem(vars(compile_ahead.config), "CACHE_DIR", str(tmp_path / "cache"))
    monkeypatch.setattr(os, "cpu_count", lambda: 4)
    return tmp_path / "cache"


def test_no_process_is_left(started, cache):
    with compiling_ahead(load(find("hold"))):
        assert len(started) == len(compile_ahead.PARTS)
    assert all(one.returncode is not None for one in started)


def test_none_is_started_where_code_is_there(started, cache):
    cache.mkdir()
    (cache / "chain.act-1.py311.nbi").touch()
    with compiling_ahead(load(find("hold"))):
        assert not started


def test_none_is_started_on_one_core(started, cache, monkeypatch):
    monkeypatch.setattr(os, "cpu_count", lambda: 1)
    with compiling_ahead(load(find("hold"))):
        assert not started


def test_flights_that_begin_together_start_them_once(started, cache):
    with (
        compiling_ahead(load(find("hold"))),
        compiling_ahead(load(find("hold"))),
    ):
        assert len(started) == len(compile_ahead.PARTS)
    with compiling_ahead(load(find("hold"))):
        assert len(started) == 2 * len(compile_ahead.PARTS)  # the lock is free again


@pytest.mark.parametrize(
    ("cores", "shares"),
    [
        (2, [["see", "plant", "law"]]),
        (3, [["see", "law"], ["plant"]]),
        (4, [["see"], ["plant"], ["law"]]),
        (64, [["see"], ["plant"], ["law"]]),
    ],
)
def test_each_process_has_a_core(started, cache, monkeypatch, cores, shares):
    """A function that two parts call is compiled in both, if they are in two processes."""
    monkeypatch.setattr(os, "cpu_count", lambda: cores)
    with compiling_ahead(load(find("hold"))):
        assert [one.args[3:] for one in started] == shares


def test_this_process_compiles_its_part_where_others_compile(monkeypatch, started, cache):
    joined = []
    monkeypatch.setattr(compile_ahead, "act", joined.append)
    experiment = load(find("hold"))
    with compiling_ahead(experiment) as compilers, compiling_ahead(experiment) as later:
        compilers.join_in()
        later.join_in()  # it waits for the code of the first one
    assert joined == [experiment]


def test_none_is_started_where_the_cache_cannot_be_written(started, cache):
    cache.parent.joinpath("cache").touch()  # a file
    with compiling_ahead(load(find("hold"))):
        assert not started


def test_a_users_law_runs_in_the_flights_process_only():
    experiment = load(find("hold"))
    assert compile_ahead._is_ours(experiment)
    assert not compile_ahead._is_ours(replace(experiment, controller=OwnLawParams("mine.py:Mine")))


def test_they_can_be_ended_before_the_flight(started, cache):
    with compiling_ahead(load(find("hold"))) as compilers:
        compilers.end()
        assert started
        assert all(one.returncode is not None for one in started)
