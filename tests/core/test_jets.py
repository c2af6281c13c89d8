"""Effect matrix and opposing pairs, against the cross product in three dimensions."""

import math

import numpy as np
import pytest

from testbed.core.jets import effect_matrix, opposing_pairs
from testbed.core.vehicle import Jet


def jet(x, y, heading, thrust=1.0):
    return Jet((x, y), (math.cos(heading), math.sin(heading)), thrust)


def random_jets(rng, count):
    low, high = (-0.3, -0.3, -math.pi, 0.1), (0.3, 0.3, math.pi, 2.0)
    return [jet(*rng.uniform(low, high).tolist()) for _ in range(count)]


@pytest.mark.parametrize("seed", range(20))
def test_effect_matrix_is_force_and_cross_product(seed):
    rng = np.random.default_rng(seed)
    jets = random_jets(rng, rng.integers(1, 12))
    about = tuple(rng.uniform(-0.1, 0.1, 2).tolist())

    effect = effect_matrix(jets, about)

    assert effect.shape == (3, len(jets))
    for column, one in zip(effect.T, jets, strict=True):
        force = one.thrust * np.array([*one.push, 0.0])
        arm = np.array([*one.position, 0.0]) - np.array([*about, 0.0])
        assert column == pytest.approx([force[0], force[1], np.cross(arm, force)[2]], abs=1e-15)


def test_effect_matrix_of_no_jets_is_empty():
    assert effect_matrix([]).shape == (3, 0)


def test_the_torque_moves_with_the_force_not_with_a_couple():
    couple = [jet(0.1, 0.0, math.pi / 2), jet(-0.1, 0.0, -math.pi / 2)]
    here, there = effect_matrix(couple), effect_matrix(couple, about=(0.03, -0.07))
    assert here.sum(axis=1) == pytest.approx([0.0, 0.0, 0.2])
    assert there.sum(axis=1) == pytest.approx([0.0, 0.0, 0.2])


def test_shipped_jets_open_together_do_nothing(shipped_vehicle):
    assert effect_matrix(shipped_vehicle.jets).sum(axis=1) == pytest.approx(np.zeros(3), abs=1e-15)


def test_shipped_vehicle_has_four_opposing_pairs(shipped_vehicle):
    # numbered from 1 in the picture of jets.py: 1-6, 2-5, 3-8, 4-7
    assert opposing_pairs(shipped_vehicle.jets) == [(0, 5), (1, 4), (2, 7), (3, 6)]


@pytest.mark.parametrize(
    ("other", "opposing"),
    [
        (jet(-0.2, 0.1, 0.0), True),  # towards the first, on its line
        (jet(0.5, 0.1, 0.0), True),  # away from it: they still pull apart
        (jet(-0.2, 0.105, 0.05), True),  # a few millimetres and degrees off
        (jet(-0.2, 0.13, 0.0), False),  # beside it: a couple
        (jet(-0.2, 0.1, 0.3), False),  # askew
        (jet(-0.2, 0.1, math.pi), False),  # the same way
        (jet(-0.2, 0.1, math.pi / 2), False),  # across
    ],
)
def test_opposing_means_against_each_other_on_one_line(other, opposing):
    first = jet(0.2, 0.1, math.pi)
    assert opposing_pairs([first, other]) == ([(0, 1)] if opposing else [])


@pytest.mark.parametrize("seed", range(5))
def test_opposing_pairs_turn_with_the_vehicle(seed, shipped_vehicle):
    rng = np.random.default_rng(seed)
    angle = rng.uniform(-math.pi, math.pi)
    c, s = math.cos(angle), math.sin(angle)
    turned = [
        Jet(
            (c * j.position[0] - s * j.position[1], s * j.position[0] + c * j.position[1]),
            (c * j.push[0] - s * j.push[1], s * j.push[0] + c * j.push[1]),
            j.thrust,
        )
        for j in shipped_vehicle.jets
    ]
    assert opposing_pairs(turned) == opposing_pairs(shipped_vehicle.jets)
