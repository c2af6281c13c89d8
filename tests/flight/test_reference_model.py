"""The reference model in compiled code: the same numbers as step by step in Python."""

from itertools import pairwise

import numpy as np
import pytest

from controllers.scale import Scale, Scaled
from controllers.sotsmc import SotsmcParams, sotsmc
from testbed.core.rows import States
from testbed.core.table import Obstacle
from testbed.core.types import Accel, Pose, State, Twist
from testbed.flight.barrier import Barrier, BarrierParams
from testbed.flight.guidance import Guidance, GuidanceParams, Kept, Received

PERIOD = 0.1  # [s]
ROCKS = {"rock": Obstacle((0.6, 0.1), 0.3)}
KEEP = {"b": 0.6, "c": 0.7}


class StepByStep:
    """A law that compiled code cannot fly as a whole."""

    message_size = 0

    def __init__(self, law):
        self.initial, self.rate, self.propagate = law.initial, law.rate, law.propagate


def law(scaled):
    """The law of zhang2023 on the table, in units of the table or of the paper."""
    one = sotsmc(SotsmcParams(), 2)
    return Scaled(one, Scale(length=50.0, time=10.0, mass=100.0)) if scaled else one


def guide(flown, vehicle, filters):
    """A guidance whose way leads through an obstacle."""
    barrier = Barrier(
        BarrierParams(), vehicle.mass, 0.4, PERIOD, (3.0, 3.0), ROCKS, KEEP
    ) if filters else None  # fmt: skip
    return Guidance(
        GuidanceParams(), flown, vehicle, Pose(1.2, 0.1, 1.0), list(ROCKS.values()), PERIOD,
        name="a", formation=("a", "b", "c"), barrier=barrier,
    )  # fmt: skip


def heard_at(k):
    """Two vehicles that come near one after the other; one of them is not heard for a while."""
    states = {
        "b": State(0.1 * k - 0.03, Pose(0.4 - 0.01 * k, 0.5, 0.2), Twist(-0.1, 0.02, 0.0),
                   Accel(0.0, 0.0, 0.0), 0.01, 0),
        "c": State(0.1 * k - 0.05, Pose(0.1, -1.2 + 0.006 * k, 0.0), Twist(0.0, 0.06, 0.0),
                   Accel(0.0, 0.0, 0.0), 0.01, 0),
    }  # fmt: skip
    if 30 <= k < 45:
        del states["b"]
    return Received(tuple(states), States.of(list(states.values())).rows, {})


def flight(guidance, ticks=120):
    """Setpoints and interventions."""
    own = (0.0, -0.2, 0.05, 0.3, *[0.0] * 8)
    for k in range(ticks):
        row = guidance.step_row(PERIOD * k, own, heard_at(k))
        yield row.tobytes(), guidance.filtered, tuple(guidance._law_state)


@pytest.mark.parametrize("scaled", [False, True])
@pytest.mark.parametrize("filters", [False, True])
def test_the_model_in_compiled_code_is_the_same_to_the_bit(scaled, filters, vehicle):
    whole = list(flight(guide(law(scaled), vehicle, filters)))
    steps = list(flight(guide(StepByStep(law(scaled)), vehicle, filters)))
    assert whole == steps
    assert guide(law(scaled), vehicle, filters)._compiled is not None
    avoided = {filtered.name for _, filtered, _ in whole if filtered is not None}
    assert avoided == ({"b", "c"} if filters else set())


def test_a_guidance_goes_on_from_the_model_of_another(vehicle):
    first = guide(law(True), vehicle, True)
    alone = list(flight(first, 40))
    one, other = guide(law(True), vehicle, True), guide(law(True), vehicle, True)
    own = (0.0, -0.2, 0.05, 0.3, *[0.0] * 8)
    for k in range(20):
        one.step_row(PERIOD * k, own, heard_at(k))
    other.take_over(one, Kept.LAW)
    rest = [other.step_row(PERIOD * k, own, heard_at(k)).tobytes() for k in range(20, 40)]
    assert rest == [row for row, _, _ in alone[20:]]


def test_what_was_sent_is_sent_again_until_it_is_due(vehicle):
    """References that the model has made never change, however they were made."""
    rows = [np.frombuffer(row)[8:].reshape(-1, 10) for row, _, _ in
            flight(guide(law(False), vehicle, True), 60)]  # fmt: skip
    for now, then in pairwise(rows):
        np.testing.assert_array_equal(now[1:], then[:-1])
