"""The minute after a flight, judged from what the plant did."""

import numpy as np
import pytest

from sim_twin.plant import Touch
from testbed.metrics.afterwards import After, Left, at_rest_after, judge_after, left_in_words


def track(*speeds):
    """Times and states of one vehicle, ten a second."""
    states = np.zeros((len(speeds), 1, 6))
    states[:, 0, 3] = speeds
    return 20.0 + 0.1 * np.arange(len(speeds)), states


@pytest.mark.parametrize(
    ("speeds", "rest"),
    [
        ((0.0, 0.0), 0.0),
        ((0.1, 0.05, 0.0), 0.2),
        ((0.1, 0.0, 0.1, 0.0005), 0.3),  # it was pushed on
        ((0.1, 0.1), None),
        ((0.0, 0.1), None),
    ],
)
def test_when_a_vehicle_is_at_rest_for_good(speeds, rest):
    t, states = track(*speeds)
    assert at_rest_after(t, states[:, 0, 3:], 20.0) == (rest and pytest.approx(rest))


def test_a_vehicle_that_turns_is_not_at_rest():
    assert at_rest_after(np.array([0.0, 1.0]), np.array([[0.0, 0.0, 0.1]] * 2), 0.0) is None


def test_hard_contacts_after_the_flight_count():
    t, states = track(0.1, 0.0)
    touches = [
        Touch(19.9, "a", "b", 0.5),  # in flight
        Touch(20.5, "a", "b", 0.01),  # soft
        Touch(70.0, "a", "upper edge", 0.03),
    ]
    after = judge_after(["a"], t, states, touches, {"a": True}, 20.0)
    assert after == After(1, pytest.approx(0.1), "on", {"a": Left(pytest.approx(0.1), "on")})


def test_the_last_vehicle_counts():
    t, states = track(0.1, 0.0)
    both = np.concatenate([states, np.full_like(states, 0.1)], axis=1)
    after = judge_after(["a", "b"], t, both, [], {"a": False, "b": False}, 20.0)
    assert (after.at_rest_s, after.air) == (None, "off")
    assert left_in_words("a", after.vehicles["a"]) == "a: at rest after 0.1 s, bearing air off"
    assert left_in_words("b", Left(None, "on")) == "b: still moving after a minute, bearing air on"
