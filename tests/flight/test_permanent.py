"""Causes that have been there since the start are found over the whole flight."""

import numpy as np
import pytest

from testbed.flight import detectors, permanent
from testbed.flight.estimator import EstimatorParams
from testbed.flight.hypotheses import (
    ALL,
    DELAYED,
    DRAG,
    LATE,
    LEAK,
    MASS,
    PULL,
    ROTATED,
    SPUN,
    THRUST,
    TURNED,
    WORTH,
)
from testbed.flight.jet_faults import known_of
from testbed.flight.memory import make_memory
from testbed.flight.record import ROW
from testbed.flight.window import SHARED

NOISE = np.array([8e-4, 8e-4, 2.5e-3])  # of a second's residual [m/s, m/s, rad/s]
PUSH = 5e-3  # of the jets in a second [m/s]


class Flight:
    """The looks of each second, summed, as the long window hands them over."""

    def __init__(self, vehicle, table, seed=1):
        self.p = known_of(vehicle, 0.1, EstimatorParams(), table)
        self.memory, _ = make_memory(len(vehicle.jets), 1, len(self.p.shown), 1)
        self.m, self.far = self.memory.fixed[0].permanent, self.memory.fixed[0].jet_faults.far
        self.jets = len(vehicle.jets)
        self.rng, self.causes = np.random.default_rng(seed), 2 * len(vehicle.jets) + SHARED

    def second(self, column=None, size=0.0, jump=(0.0, 0.0, 0.0)):
        """Jets push anywhere; a cause of this size explains the residual, and a jump."""
        sums, first = self.memory.evidence.sums, self.causes
        x, y = PUSH * self.rng.standard_normal(2)
        sums[:] = 0.0
        sums[:2, first + ALL], sums[:2, first + ROTATED] = (x, y), (-y, x)
        sums[:2, first + DELAYED] = PUSH * self.rng.standard_normal(2)
        # a torque of 1 rad/s^2, after the jets and the centre of mass
        sums[2, first + SPUN] = sums[2, first - SHARED - self.jets + 2] = 1.0
        explained = size * sums[:, first + column] if column is not None else np.zeros(3)
        sums[:, -1] = explained + NOISE * self.rng.standard_normal(3) + jump
        permanent.refute(self.m, self.far)
        permanent.update(self.p, self.m, self.memory.permanent, self.memory.evidence, self.far)

    def sigmas(self, kind):
        return permanent.surest(self.far, self.m, self.p.least, kind)

    @property
    def lateness(self):
        return permanent.lateness(self.memory.fixed[0].jet_faults, self.m, self.p.least)


@pytest.fixture
def flight(vehicle, table):
    return Flight(vehicle, table)


@pytest.mark.parametrize("torque", [0.0, 0.01, -0.03])  # [rad/s^2]; its tolerance is 0.02
def test_a_steady_torque_hides_no_heading(flight, torque):
    for _ in range(30):
        flight.second(ROTATED, np.radians(15.0), jump=(0.0, 0.0, torque))
    assert flight.sigmas(TURNED) > 6.0


def test_a_heading_that_is_off_is_found_with_its_size(flight):
    for _ in range(30):
        flight.second(ROTATED, np.radians(15.0))
    assert flight.sigmas(TURNED) > 6.0
    assert np.degrees(flight.m.sizes[TURNED]) == pytest.approx(15.0, abs=4.5)  # 3 sigma
    assert flight.sigmas(THRUST) == flight.lateness == 0.0


def test_thrust_of_half_is_found(flight):
    for _ in range(60):
        flight.second(ALL, -0.5)
    assert flight.sigmas(THRUST) > 6.0
    assert flight.sigmas(TURNED) == 0.0


@pytest.mark.parametrize(("looks", "found"), [(1.2, True), (0.5, False)])
def test_late_poses_are_found_when_they_are_late_enough(flight, looks, found):
    for _ in range(60):
        flight.second(DELAYED, looks)  # of 0.1 s
    assert flight.m.gains[LATE] > 100.0
    assert flight.m.sizes[LATE] == pytest.approx(0.1 * looks, rel=0.2)
    assert flight.lateness == 0.0  # the innovations have not heard of it
    flight.memory.fixed[0].jet_faults.innovations.gains[LATE] = 2.0 * WORTH
    assert bool(flight.lateness) == found


@pytest.mark.parametrize(
    ("gain", "size", "agrees"),
    [(200.0, -0.5, True), (200.0, -0.4, True), (200.0, -0.2, False), (5.0, -0.5, False),
     (10.0, -0.3, True), (200.0, 0.5, False)],
)  # fmt: skip
def test_innovations_confirm_a_thrust_of_half(flight, gain, size, agrees):
    for _ in range(60):
        flight.second(ALL, -0.5)
    suspected = flight.memory.fixed[0].jet_faults
    suspected.innovations.gains[THRUST], suspected.innovations.sizes[THRUST] = gain, size
    found = permanent.wrong_scale(suspected, flight.m, flight.p.least)
    assert found == (flight.sigmas(THRUST) if agrees else 0.0)


@pytest.mark.parametrize(
    ("gain", "size", "agrees"), [(0.0, 0.0, False), (2.0, 1.0, True), (2.0, -1.0, False)]
)
def test_innovations_confirm_a_heading_that_is_off(flight, gain, size, agrees):
    for _ in range(20):
        flight.second(ROTATED, 0.3)
    suspected = flight.memory.fixed[0].jet_faults
    suspected.far.gains[:] = 0.0  # the long window has seen nothing lately
    suspected.innovations.gains[TURNED] = gain * WORTH
    suspected.innovations.sizes[TURNED] = size * flight.m.sizes[TURNED]
    found = permanent.heading_off(suspected, flight.m, flight.p.least)
    assert (found > 6.0) == agrees


def test_the_estimator_settles_in_the_first_second(flight):
    flight.second(jump=(-1e-2, 0.0, 0.0))
    assert flight.m.sums == 0
    assert not flight.m.gains.any()
    for _ in range(30):
        flight.second()
    assert flight.m.sums == 30
    assert flight.m.gains.max() < 8.0  # 4 sigma
    assert np.sqrt(flight.m.noise) == pytest.approx(NOISE[0], rel=0.2)


def test_a_heading_that_is_off_is_believed_after_ten_seconds(flight):
    for _ in range(permanent.LEAST_SUMS):
        flight.second(ROTATED, np.radians(30.0))
    assert flight.m.gains[TURNED] > 18.0  # 6 sigma
    assert flight.sigmas(TURNED) == 0.0
    flight.second(ROTATED, np.radians(30.0))
    assert flight.sigmas(TURNED) > 6.0


def test_a_later_cause_that_is_not_worth_a_number_silences_nothing(flight):
    for _ in range(30):
        flight.second(ROTATED, np.radians(15.0))
    flight.far.gains[PULL] = WORTH - 1.0
    assert flight.sigmas(TURNED) > 6.0
    flight.far.gains[PULL] = WORTH + 1.0
    assert flight.sigmas(TURNED) == 0.0


def test_what_began_later_is_left_to_the_long_window(flight):
    for _ in range(30):
        flight.second(ROTATED, np.radians(15.0))
    flight.far.gains[PULL] = 10.0
    assert flight.sigmas(TURNED) == 0.0
    flight.far.gains[PULL] = 0.0
    assert flight.sigmas(TURNED) > 6.0
    flight.far.gains[PULL] = 50.0
    flight.second(ROTATED, np.radians(15.0))
    flight.far.gains[PULL] = 0.0  # the long window forgets
    assert flight.sigmas(TURNED) == 0.0


@pytest.mark.parametrize("begins", [PULL, DRAG, LEAK])
def test_what_the_long_window_has_refuted_is_not_its_answer_later(flight, begins):
    """It forgets when a hose began to pull; then a wrong mass explains the motion better."""
    gains, sizes = flight.far.gains, flight.far.sizes
    gains[begins], gains[MASS], gains[THRUST] = 50.0, 45.0, 40.0
    permanent.refute(flight.m, flight.far)
    assert flight.sigmas(THRUST) == gains[MASS] == gains[THRUST] == 0.0
    gains[begins], gains[MASS], sizes[MASS] = 30.0, 60.0, -0.4
    permanent.refute(flight.m, flight.far)
    assert flight.sigmas(THRUST) == gains[MASS] == sizes[MASS] == 0.0
    assert gains[begins] == 30.0


@pytest.mark.parametrize(("pull", "mass"), [(12.0, 1.0), (50.0, 48.0), (50.0, 60.0)])
def test_the_long_window_refutes_only_what_it_is_sure_of(flight, pull, mass):
    flight.far.gains[PULL], flight.far.gains[MASS], flight.far.sizes[MASS] = pull, mass, -0.4
    permanent.refute(flight.m, flight.far)
    assert flight.far.gains[MASS] == mass
    assert bool(flight.sigmas(THRUST)) == (mass > pull)


def test_old_poses_silence_it_until_the_next_second(flight):
    for _ in range(30):
        flight.second(ROTATED, np.radians(15.0))
    fixed, row = flight.memory.fixed[0], np.zeros(1, ROW)[0]
    row.state.pose_age, still = 0.2, np.zeros(len(flight.memory.begun))
    detectors.compare(
        flight.p, fixed.jet_faults, flight.memory.evidence, flight.memory.fired, flight.m,
        flight.memory.permanent, row, np.zeros(3), still, 1.0,
    )  # fmt: skip
    assert flight.sigmas(TURNED) == 0.0
    flight.second(ROTATED, np.radians(15.0))
    assert flight.sigmas(TURNED) > 6.0


def test_a_jet_that_was_taken_out_begins_a_new_flight(flight):
    for _ in range(30):
        flight.second(ROTATED, np.radians(15.0))
    permanent.restart(flight.m, flight.memory.permanent)
    assert flight.sigmas(TURNED) == 0.0
    flight.second(ROTATED, np.radians(15.0))
    assert flight.m.sums == 0


def test_the_words_come_from_the_window_that_is_surer(flight):
    suspected = flight.memory.fixed[0].jet_faults
    for _ in range(30):
        flight.second(ROTATED, np.radians(15.0))
    assert permanent.verdict_of(suspected, flight.m, TURNED) == flight.m
    assert permanent.verdict_of(suspected, flight.m, PULL) == flight.far
    flight.far.gains[TURNED] = flight.m.gains[TURNED] + 1.0
    assert permanent.verdict_of(suspected, flight.m, TURNED) == flight.far
