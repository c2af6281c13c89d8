"""A jet that gives nothing is found, and healthy ones of unequal strength are not suspected."""

import numpy as np
import pytest

from testbed.core.jets import effect_matrix
from testbed.core.types import Accel, Pose, State, Twist
from testbed.flight.jet_faults import LAG, JetFaultDetector

PERIOD = 0.1  # [s]
BOUND = 4.0  # of the fault table
NOISE = np.array([3e-4, 3e-4, 8e-4])  # of a velocity estimate in flight [m/s, m/s, rad/s]


class Body:
    """A vehicle whose jets give a share of what the file says.

    Its filter knows the commands at once, and what they do not explain after a while.
    """

    def __init__(self, vehicle, gains, seed):
        scale = np.array([[vehicle.mass], [vehicle.mass], [vehicle.inertia]])
        self._effect = effect_matrix(vehicle.jets, about=vehicle.com) / scale
        self.gains = gains
        self._rng, self._t, self._theta = np.random.default_rng(seed), 0.0, 0.4
        self._true, self._seen = np.zeros(3), np.zeros(3)
        self.evidence = JetFaultDetector(vehicle, PERIOD)

    def tick(self, duty):
        c, s = np.cos(self._theta), np.sin(self._theta)
        turn = np.array(((c, -s, 0.0), (s, c, 0.0), (0.0, 0.0, 1.0)))
        self._true += PERIOD * turn @ (self._effect @ (duty * self.gains))
        self._seen += PERIOD * turn @ (self._effect @ duty)
        self._seen += PERIOD / LAG * (self._true - self._seen)
        self._t += PERIOD
        vx, vy, omega = self._seen + NOISE * self._rng.standard_normal(3)
        state = State(
            self._t, Pose(0.0, 0.0, self._theta), Twist(vx, vy, omega), Accel(0, 0, 0), 0.02, 0
        )
        self.evidence.look(state, duty, 1.0)
        return self.evidence.missing, self.evidence.jet


def turn_after_rest(rng, jets):
    """A minute of little, then six seconds of three jets that fire hard together, and again."""
    duties = np.zeros((1200, jets))
    little = rng.random((1200, jets)) < 0.15
    duties[little] = rng.uniform(0.1, 0.2, little.sum())
    for begin in (600, 900):
        three = rng.choice(jets, 3, replace=False)
        for k in range(60):
            duties[begin + k, three] = np.array((0.5, 0.2, 0.6)) * np.exp(-k / 30)
    return duties


@pytest.mark.parametrize("seed", range(12))
def test_unequal_jets_in_a_hard_turn_are_not_suspected(seed, vehicle):
    rng, jets = np.random.default_rng(seed), len(vehicle.jets)
    gains = 1.0 + vehicle.tolerance.thrust * rng.standard_normal(jets)
    body = Body(vehicle, gains, seed)
    worst = max(body.tick(duty)[0] for duty in turn_after_rest(rng, jets))
    assert worst < BOUND


@pytest.mark.parametrize("stuck", range(8))
def test_a_jet_that_gives_nothing_is_found_and_named(stuck, vehicle):
    rng, jets = np.random.default_rng(stuck), len(vehicle.jets)
    gains = 1.0 + 0.05 * rng.standard_normal(jets)
    body = Body(vehicle, gains, stuck)
    for _ in range(300):  # healthy at first
        on = (rng.random(jets) < 0.3) * rng.uniform(0.1, 0.3, jets)
        assert body.tick(on)[0] < BOUND
    body.gains[stuck] = asked = 0.0
    for _ in range(600):
        on = (rng.random(jets) < 0.3) * rng.uniform(0.1, 0.3, jets)
        asked += PERIOD * on[stuck]
        missing, jet = body.tick(on)
        if missing > BOUND:
            break
    assert missing > BOUND
    assert jet == stuck
    assert asked < 2.0  # [s] of open time that the jet was asked for


def test_nothing_fired_says_nothing(vehicle):
    body = Body(vehicle, np.zeros(len(vehicle.jets)), 1)
    assert max(body.tick(np.zeros(len(vehicle.jets)))[0] for _ in range(300)) == 0.0
