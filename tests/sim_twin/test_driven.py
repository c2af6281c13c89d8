"""Solenoids behind somebody else's board move the plant as the modelled board does."""

import numpy as np
import pytest

from sim_twin.board import LONG_AFTER
from sim_twin.plant import Plant
from testbed.core.types import Pose, ValveCommand


class Score:
    """A driver that plays edges written down beforehand."""

    floats = True

    def __init__(self, edges):
        self._edges, self.heard = list(edges), []

    def apply(self, command):
        self.heard.append(command)

    def run_until(self, t_us):
        due = [edge for edge in self._edges if edge[0] <= t_us]
        self._edges = self._edges[len(due) :]
        return due


@pytest.fixture
def exact_vehicle(make_vehicle):
    return make_vehicle()


@pytest.fixture
def new_plant(exact_vehicle, make_table):
    def make(edges=None):
        drivers = None if edges is None else {"0": Score(edges)}
        vehicles, starts = {"0": exact_vehicle}, {"0": Pose(0.0, 0.0, 0.3)}
        return Plant(vehicles, starts, make_table(), {}, 5, drivers)

    return make


def test_same_pulses_same_motion(new_plant, exact_vehicle):
    """Jets 0 and 2 by plan, over three periods, one pulse open across a border."""
    modelled = new_plant()
    start = round(exact_vehicle.command_delay_s * 1e6)
    edges = [
        (start, 0b001), (start + 50_000, 0b101), (start + 100_000, 0b100),
        (start + 180_000, 0b000), (start + 210_000, 0b001), (start + 225_500, 0b000),
    ]  # fmt: skip
    driven = new_plant(edges)
    for k, (on, offset) in enumerate((
        ({0: 100_000, 2: 50_000}, {2: 50_000}), ({2: 80_000}, {}), ({0: 15_500}, {0: 10_000}),
    )):  # fmt: skip
        spread = [tuple(at.get(j, 0) for j in range(8)) for at in (on, offset)]
        command = ValveCommand(k, 0.1 * k, 0.1 * (k + 1), *spread)
        for plant in (modelled, driven):
            plant.boards["0"].apply(command)
            plant.advance(0.1 * (k + 1))
    for plant in (modelled, driven):
        plant.advance(0.5)
    assert np.abs(modelled.x).max() > 1e-3
    np.testing.assert_allclose(driven.x, modelled.x, rtol=0, atol=1e-15)
    assert driven.boards["0"].openings == modelled.boards["0"].openings == 3
    assert driven.boards["0"].edges == edges
    assert len(driven.boards["0"]._driver.heard) == 3


def test_the_step_does_not_matter_while_a_valve_is_open(new_plant):
    edges = [(10_000, 1), (170_000, 0)]
    ends = []
    for step in (0.001, 0.013, 0.3):
        plant = new_plant(edges)
        while plant.t < 0.299:
            plant.advance(min(0.3, plant.t + step))
        plant.advance(0.3)
        ends.append(plant.x[0].copy())
    np.testing.assert_allclose(ends[0], ends[2], rtol=0, atol=1e-12)
    np.testing.assert_allclose(ends[1], ends[2], rtol=0, atol=1e-12)


def test_a_valve_without_a_closing_edge_stays_open(new_plant):
    plant = new_plant([(0, 1)])
    plant.advance(1.0)
    assert plant.boards["0"].pulses.down[0, -1] == LONG_AFTER


def test_firmware_that_shuts_the_air_off_lands_its_vehicle(new_plant):
    plant = new_plant([])
    plant.advance(0.1)
    assert plant.floats(0)
    plant.boards["0"]._driver.floats = False
    plant.advance(0.2)
    assert not plant.floats(0)
