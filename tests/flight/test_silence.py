"""Whose silence it is: the sender's, or that of the vehicle's own link."""

import pytest
from msgspec.structs import replace

from testbed.config import find, load
from testbed.config.shipped import shipped_faults
from testbed.core.codes import FaultReport
from testbed.core.types import ALL_WELL, Demand, Health, Inputs, Outputs, Tick, ValveCommand, Wrench
from testbed.flight.silence import blame_link
from testbed.flight.witnesses import Witnesses
from testbed.rig.observers import NullObserver
from testbed.rig.twin import make_twin

ROWS = list(shipped_faults().items())
NOW = 10.0  # [s]


def told(make_state, setpoint=None, operator=0.0, **others):
    """Inputs at a tick; the numbers are ages [s]."""
    aim = None if setpoint is None else Demand(NOW - setpoint, 0.0, 0.0, 0.0, 0.0, 0.0, NOW)
    states = {name: make_state(t=NOW - age) for name, age in others.items()}
    vitals = replace(ALL_WELL, operator_age=operator)
    return Inputs(NOW, True, (), aim, states, Health(NOW, 0.0, 0.0), vitals=vitals)


def report(row, value, said="sat2"):
    return dict(ROWS)[row].report(row, value, said, None)


SILENT = report("neighbour_silent", 1.59)
GONE = report("operator_gone", 1.01)


@pytest.mark.parametrize(
    ("fault", "ages"),
    [
        (SILENT, {"setpoint": 1.5, "sat2": 1.59, "sat3": 1.49}),  # a law on the host
        (SILENT, {"sat2": 1.59, "sat3": 1.2}),  # a law on board
        (GONE, {"setpoint": 0.98, "operator": 1.01, "sat2": 1.09}),  # on wires
        (GONE, {"setpoint": 0.98, "operator": 1.01}),  # alone: the link, or its host
    ],
)
def test_a_vehicle_that_hears_nothing_has_lost_its_link(fault, ages, make_state):
    found = blame_link(fault, ROWS, told(make_state, **ages))
    assert (found.id, found.detector, found.value) == ("link_lost", fault.detector, fault.value)
    assert found.text.startswith(f"link lost: nothing heard for {min(ages.values()):.2f} s from ")
    assert all(name in found.text for name in ages if name.startswith("sat"))
    assert found.notes == (fault.words,)


@pytest.mark.parametrize(
    ("fault", "ages"),
    [
        (SILENT, {"setpoint": 0.1, "sat2": 1.59, "sat3": 1.49}),  # the host speaks
        (SILENT, {"sat2": 1.59, "sat3": 0.1}),  # the third vehicle speaks
        (SILENT, {"sat2": 1.59}),  # one sender: it or the link
        (SILENT, {"sat2": 1.59, "sat3": 1.49, "operator": 0.2}),  # the operator is there
        (GONE, {"setpoint": 0.1, "operator": 1.01, "sat2": 0.1}),
        (report("link_lost", 1.1, ""), {"setpoint": 1.6, "sat2": 1.5}),  # it has that name already
        (report("pose_lost", 3.0, ""), {"setpoint": 1.6, "sat2": 1.5}),
    ],
)
def test_a_silent_sender_keeps_its_name(fault, ages, make_state):
    assert blame_link(fault, ROWS, told(make_state, **ages)) is fault


def test_without_a_row_for_a_lost_link_nothing_changes(make_state):
    rows = [(name, row) for name, row in ROWS if name != "link_lost"]
    assert blame_link(SILENT, rows, told(make_state, sat2=1.59, sat3=1.5)) is SILENT


def tick(inputs, state):
    still, command = Wrench(0.0, 0.0, 0.0), ValveCommand(0, NOW, NOW, (), ())
    return Tick(inputs, Outputs(NOW, state, None, still, still, command))


@pytest.mark.parametrize("flies", [True, False])
def test_of_two_vehicles_the_run_knows_whether_the_other_one_flies(flies, make_state):
    witnesses, fault = Witnesses(), replace(SILENT, vehicle="sat1")
    witnesses.add("sat1", tick(told(make_state, sat2=1.59), make_state()))
    witnesses.add("sat2", tick(told(make_state), make_state() if flies else None))
    found = witnesses.blamed(fault)
    assert (found.id, found.vehicle) == ("link_lost" if flies else "neighbour_silent", "sat1")


def aged(make_state, t, **stamps):
    """A tick at `t`; the numbers are stamps of the states heard [s]."""
    inputs = told(make_state, **{name: NOW - stamp for name, stamp in stamps.items()})
    return tick(replace(inputs, t=t), make_state())


@pytest.mark.parametrize(
    ("every", "ticks", "name"),
    [
        (3, 17, "link_lost"),  # two of three messages are lost
        (1, 17, "neighbour_silent"),  # the other sender is heard
        (3, 9, "neighbour_silent"),  # too few ticks to say so
    ],
)
def test_a_link_that_loses_most_of_what_all_send_is_lost(every, ticks, name, make_state):
    witnesses = Witnesses()
    for k in range(ticks):
        t = 0.1 * k
        stamp = 0.1 * (k // every * every)
        witnesses.add("sat1", aged(make_state, t, sat2=-0.1, sat3=stamp))
    found = witnesses.blamed(replace(SILENT, vehicle="sat1"))
    assert found.id == name
    assert name != "link_lost" or "at most 31% heard in 1.6 s of what sat2, sat3 sent" in found.text


@pytest.mark.parametrize("name", ["zhang2023_table", "zhang2023_table_wrench"])
@pytest.mark.parametrize(
    ("kind", "culprit", "fault"),
    [("lose_link", "sat2", "link_lost"), ("kill_process", "sat1", "neighbour_silent")],
)
def test_a_lost_link_is_told_from_a_silent_vehicle(name, kind, culprit, fault):
    inject = f'inject=[{{kind="{kind}",vehicle="sat2",at_s=2.03}}]'
    ending = make_twin(load(find(name), [inject, "duration_s=6", "seed=3"])).fly(NullObserver())
    assert isinstance(ending.fault, FaultReport)
    assert (ending.fault.vehicle, ending.fault.id) in ((culprit, fault), ("sat2", "vehicle_silent"))
    assert kind != "lose_link" or ending.fault.id == fault
