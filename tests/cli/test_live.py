"""The live table: what it says, and that it says nothing in a pipe."""

import io

import numpy as np
import pytest
from msgspec.structs import replace
from rich.console import Console

from patience import wait_for
from testbed.cli.live import LiveTable
from testbed.config import find, load
from testbed.core.codes import FaultReport
from testbed.flight.flown_tick import FlownTick
from testbed.report.goal_error import GoalError
from testbed.rig.twin import make_twin


def structs(tick):
    """The tick as structs."""
    return tick.tick if isinstance(tick, FlownTick) else tick


class Shower:
    """Observer that only shows."""

    def __init__(self, live: LiveTable) -> None:
        self.live = live

    def vehicle(self, name, tick) -> None:
        self.live.vehicle(name, tick)

    def host(self, name, tick) -> None: ...

    def done(self, t) -> None:
        self.live.done(t)


def flown(console: Console, *overrides: str) -> LiveTable:
    experiment = load(find("zhang2023_table"), ["duration_s=2", *overrides])
    live = LiveTable(experiment, console)
    with live.showing():
        live.flies()
        make_twin(experiment).fly(Shower(live))
    return live


def words(live: LiveTable) -> str:
    out = Console(file=io.StringIO(), width=120)
    out.print(live.picture())
    return out.file.getvalue()


def test_a_row_for_every_vehicle():
    said = words(flown(Console(file=io.StringIO())))
    for word in ("zhang2023_table", "sat1", "sat2", "sat3", "flies", "error [mm]", "gas [%]",
                 "clearance [m]", "pose age [ms]"):  # fmt: skip
        assert word in said
    row = next(line for line in said.splitlines() if line.startswith("sat1"))
    error, clearance, speed, gas, _age = map(float, row.split()[2:])
    assert 3200.0 < error < 3400.0
    assert clearance == pytest.approx(1.65, abs=0.05)
    assert 0.0 < speed < 60.0
    assert gas == 100.0


def test_a_board_without_a_gauge_has_no_percentage():
    live = flown(Console(file=io.StringIO()))
    for name, tick in list(live._ticks.items()):
        tick = structs(tick)
        health = replace(tick.inputs.health, tank_pressure=0.0)
        live.vehicle(name, replace(tick, inputs=replace(tick.inputs, health=health)))
    row = next(line for line in words(live).splitlines() if line.startswith("sat1"))
    assert row.split()[-2] == "-"


def test_a_fault_is_in_it():
    said = words(flown(Console(file=io.StringIO()), "flight.gate.max_speed=1e-6"))
    assert "too fast" in said


def test_the_culprit_and_those_who_stop_with_it_are_told_apart():
    stuck = 'inject=[{kind="stick_open",vehicle="sat3",at_s=1.03,jet=3}]'
    said = words(flown(Console(file=io.StringIO()), "duration_s=4", stuck))
    rows = {line.split()[0]: line for line in said.splitlines() if line.startswith("sat")}
    assert "FAULT valve stuck open" in rows["sat3"]
    assert "stopping with the others" in rows["sat1"]
    assert "FAULT" not in rows["sat1"] + rows["sat2"]


def test_vehicles_have_the_order_of_the_experiment_and_the_culprit_comes_first():
    stuck = 'inject=[{kind="stick_open",vehicle="sat3",at_s=1.03,jet=3}]'
    live = flown(Console(file=io.StringIO()), "duration_s=4", stuck)
    live._ticks = {name: live._ticks[name] for name in ("sat2", "sat3", "sat1")}  # as they came
    rows = [line.split()[0] for line in words(live).splitlines() if line.startswith("sat")]
    assert rows == ["sat1", "sat2", "sat3"]
    line = live.line()
    off = [line.index(f"{name} ") for name in rows]
    assert off == sorted(off)
    told = [line.index(f"{name}: ") for name in ("sat3", "sat1", "sat2")]
    assert told == sorted(told)
    assert line.index("valve stuck open") < line.index("stopped with the others")


def test_before_the_first_tick():
    experiment = load(find("hold"))
    assert "getting ready" in words(LiveTable(experiment, Console(file=io.StringIO())))


def test_a_pipe_hears_nothing():
    console = Console(file=io.StringIO())
    flown(console)
    assert console.file.getvalue() == ""


def test_a_terminal_sees_it_and_it_goes_away():
    console = Console(file=io.StringIO(), force_terminal=True, width=120)
    flown(console)
    said = console.file.getvalue()
    assert "sat3" in said
    assert said.count("\n") < 2000


def test_the_error_of_a_formation_is_of_its_edges():
    experiment = load(find("xue2024_table_constant"), ["duration_s=2"])
    live = LiveTable(experiment, Console(file=io.StringIO()))
    with live.showing():
        live.flies()
        make_twin(experiment).fly(Shower(live))
    rows = {line.split()[0]: line.split() for line in words(live).splitlines() if "flies" in line}
    wanted = {frozenset((e.a, e.b)): e.length for e in GoalError(experiment).edges}
    place = {name: np.array(setup.start[:2]) for name, setup in experiment.vehicles.items()}
    first = abs(np.linalg.norm(place["sat1"] - place["sat2"]) - wanted[frozenset(("sat1", "sat2"))])
    assert float(rows["sat1"][2]) == pytest.approx(1e3 * first, abs=30.0)  # little has moved


def test_a_flight_in_a_pipe_says_a_line_now_and_then():
    out = io.StringIO()
    experiment = load(find("zhang2023_table"), ["duration_s=2"])
    live = LiveTable(experiment, Console(file=out), line_s=0.001)
    with live.showing():
        wait_for(lambda: "zhang2023_table: getting ready" in out.getvalue())
        live.flies()
        wait_for(lambda: "zhang2023_table: waiting for its vehicles" in out.getvalue())
        make_twin(experiment).fly(Shower(live))
        wait_for(lambda: out.getvalue().endswith(f"{live.line()}\n"))
    lines = out.getvalue().splitlines()
    assert ", sat1 33" in lines[-1]
    assert "mm off" in lines[-1]
    for first in ("getting ready", "waiting"):  # said once, although it has lasted
        assert sum(f": {first}" in line for line in lines) == 1


def test_a_long_state_folds_at_80_columns_and_no_number_is_cut():
    live = flown(Console(file=io.StringIO()))
    why = FaultReport("valve_stuck_open_on_the_second_vehicle", "jet 3 pushes")
    tick = structs(live._ticks["sat2"])
    live._ticks["sat2"] = replace(tick, outputs=replace(tick.outputs, fault=why))
    out = Console(file=io.StringIO(), width=80)
    out.print(live.picture())
    said = out.file.getvalue()
    assert "\N{HORIZONTAL ELLIPSIS}" not in said
    assert max(map(len, said.splitlines())) <= 80
    for heading in ("clearance [m]", "pose age [ms]", "speed [mm/s]"):
        assert heading in said
    row = next(line for line in said.splitlines() if line.startswith("sat3"))
    assert len(row.split()) == 7


@pytest.mark.parametrize(("width", "headings"), [(40, 1), (60, 3), (80, 5)])
def test_a_narrow_terminal_shows_fewer_numbers_and_whole_names(width, headings):
    live = flown(Console(file=io.StringIO(), width=width))
    out = Console(file=io.StringIO(), width=width)
    out.print(live.picture())
    said = out.file.getvalue()
    table = said[said.index("vehicle") :]
    assert "\N{HORIZONTAL ELLIPSIS}" not in table
    assert max(map(len, said.splitlines())) <= width
    rows = [line.split() for line in said.splitlines() if line.startswith("sat")]
    assert [row[:2] for row in rows] == [[name, "flies"] for name in ("sat1", "sat2", "sat3")]
    assert {len(row) for row in rows} == {2 + headings}
