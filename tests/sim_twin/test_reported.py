"""Valves that follow what firmware reports."""

import numpy as np
import pytest

from sim_twin.board import LONG_AGO
from sim_twin.plant import Plant
from sim_twin.reported import NOT_YET, ReportedValves
from testbed.config import find, load
from testbed.core.types import Pose, ValveCommand

MS = 1_000_000  # [ns]


@pytest.fixture
def experiment():
    return load(find("hold"))


@pytest.fixture
def make_plant(experiment):
    def make():
        setup = experiment.vehicles["sat1"]
        return Plant({"sat1": setup.model}, {"sat1": Pose(0, 0, 0)}, experiment.table, {}, 3)

    return make


@pytest.fixture
def valves(experiment, make_plant):
    plant = make_plant()
    model = experiment.vehicles["sat1"].model
    return ReportedValves(model, plant.boards["sat1"].pulses, np.random.default_rng(1))


def test_an_edge_opens_and_the_next_closes(valves):
    valves.edge(5 * MS, 0b101, 0.0)
    assert valves.pulses.up[[0, 2], -1].tolist() == [5 * MS, 5 * MS]
    assert valves.pulses.down[[0, 2], -1].tolist() == [NOT_YET, NOT_YET]
    valves.edge(25 * MS, 0b100, 0.0)
    assert valves.pulses.down[0, -1] == 25 * MS
    assert valves.pulses.down[2, -1] == NOT_YET
    assert (valves.pulses.up[1] == LONG_AGO).all()
    valves.close_all(30 * MS)
    assert valves.pulses.down[2, -1] == 30 * MS
    assert valves.openings == 2


def test_an_edge_is_late_when_the_plant_is_past_what_it_does(valves):
    valves.edge(10 * MS, 1, 0.0159)  # dead time is 6 ms
    assert valves.late == 0
    valves.edge(20 * MS, 0, 0.0261)
    assert valves.late == 1


def flows(valves):
    """How long the newest two pulses of jet 1 are open [ms]."""
    return ((valves.pulses.down - valves.pulses.up)[0, -2:] / MS).tolist()


def test_a_pulse_that_is_reported_late_flows_later_and_as_long(valves):
    valves.edge(10 * MS, 1, 0.026)  # the plant has passed 20 ms of commands
    assert valves.pulses.up[0, -1] == 20 * MS
    valves.edge(25 * MS, 0, 0.026)
    assert valves.pulses.down[0, -1] == 35 * MS
    assert valves.late == 1


def test_a_pulse_that_flowed_too_long_is_taken_from_the_next(valves):
    valves.edge(10 * MS, 1, 0.0)
    valves.edge(25 * MS, 0, 0.035)  # it has flowed until 29 ms of commands
    assert valves.pulses.down[0, -1] == 29 * MS
    valves.edge(110 * MS, 1, 0.1)
    valves.edge(130 * MS, 0, 0.1)
    assert flows(valves) == [19.0, 16.0]
    valves.edge(210 * MS, 1, 0.2)
    valves.edge(230 * MS, 0, 0.2)
    assert flows(valves) == [16.0, 20.0]


def test_a_pulse_shorter_than_what_the_one_before_flowed_too_long_does_not_flow(valves):
    valves.edge(10 * MS, 1, 0.0)
    valves.edge(25 * MS, 0, 0.035)  # 4 ms too long
    valves.edge(110 * MS, 1, 0.1)
    valves.edge(113 * MS, 0, 0.1)
    valves.edge(210 * MS, 1, 0.2)
    valves.edge(230 * MS, 0, 0.2)
    assert flows(valves) == [0.0, 19.0]


def test_the_plant_moves_as_with_the_modelled_board(experiment, make_plant):
    """The same pulses, planned for the modelled board and reported by a real one."""
    rng = np.random.default_rng(4)
    model = experiment.vehicles["sat1"].model
    planned, reported = make_plant(), make_plant()
    for plant in (planned, reported):  # no chance: pulses as they are
        board = plant.boards["sat1"]
        board.wires = board.wires._replace(spread=0.0)
    valves = ReportedValves(model, reported.boards["sat1"].pulses, np.random.default_rng(1))
    valves._spread = 0.0
    for k in range(30):
        t = 0.1 * k
        on = rng.integers(12_000, 60_000, 8) * (rng.random(8) < 0.4)
        command = ValveCommand(k, t, t + 0.1, tuple(on.tolist()), (20_000,) * 8)
        planned.boards["sat1"].apply(command)
        start = round(1e9 * (t + model.command_delay_s)) + 20 * MS
        edges = {start: 0}
        ends = {j: start + 1000 * int(on[j]) for j in range(8) if on[j]}
        for at in sorted({start, *ends.values()}):
            mask = sum(1 << j for j, end in ends.items() if start <= at < end)
            edges[at] = mask
        for at, mask in edges.items():
            valves.edge(at, mask, reported.t)
        planned.advance(t + 0.1)
        reported.advance(t + 0.1)
    assert valves.late == 0
    assert valves.openings == planned.boards["sat1"].openings
    np.testing.assert_allclose(reported.x, planned.x, rtol=0, atol=1e-12)
