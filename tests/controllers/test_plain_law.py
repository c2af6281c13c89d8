"""A law in plain Python: what it gets is read-only, its force is limited, its step is a time."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from controllers.law_file import UnusableLawError
from controllers.plain_law import PlainLaw
from testbed.core.law import Body, Discs, Goal, Neighbours, World, bounded

ZERO = np.zeros(2)
OWN = Body(np.array([1.0, 2.0]), ZERO.copy(), 12.0, ZERO.copy(), ZERO.copy(), 0.5)
OTHERS = Neighbours(
    np.ones((1, 2)), np.zeros((1, 2)), np.ones(1), np.array([1]), np.zeros((1, 1)), np.zeros(1)
)
WORLD = World(
    Goal(ZERO.copy(), ZERO.copy(), ZERO.copy(), ZERO.copy()),
    Discs(np.ones((1, 2)), np.zeros((1, 2)), np.ones(1)),
)


def asked(force, **more):
    return PlainLaw(SimpleNamespace(force=force, **more), None)


def arrays(nested):
    parts = (one for part in nested for one in arrays(part)) if isinstance(nested, tuple) else ()
    return [nested] if isinstance(nested, np.ndarray) else list(parts)


def test_all_arrays_that_a_law_gets_are_read_only_in_all_its_methods():
    seen = []

    def rate(law_state, own, neighbours, world, t):
        seen.append((own, neighbours, world, law_state))
        return 0.0 * own.p, 0.0 * law_state

    def initial(own, neighbours, world):
        seen.append((own, neighbours, world))
        return np.zeros(1)

    def jump(law_state, own, neighbours, world, t):
        seen.append((own, neighbours, world))
        law_state += 1.0  # a copy
        return law_state

    def broadcast(law_state, own, neighbours, world, t):
        seen.append((own, neighbours, world, law_state))
        return law_state

    made = SimpleNamespace(
        rate=rate, initial=initial, jump=jump, broadcast=broadcast, message_size=1
    )
    law = PlainLaw(made, None)
    state = law.initial(OWN, OTHERS, WORLD)
    ahead = law.propagate(state, OWN, OTHERS, WORLD, 0.0, 0.1, 3)
    assert (state.tolist(), ahead.law_state.tolist(), ahead.message.tolist()) == ([0], [1], [1])
    assert len(seen) == 1 + 1 + 3 + 1
    assert all(not one.flags.writeable for one in arrays(tuple(seen)))
    assert all(one.flags.writeable for one in arrays((OWN, OTHERS, WORLD, state)))


def test_a_read_only_array_follows_the_prediction():
    places = []

    def force(own, neighbours, world, t):
        places.append(own.p.tolist())
        return np.array([0.3, 0.0])

    ahead = asked(force).propagate(np.zeros(0), OWN, OTHERS, WORLD, 0.0, 1.0, 4)
    assert places[0] == [1.0, 2.0]
    assert sorted(x for x, _ in places) == [x for x, _ in places] != [1.0] * 4
    assert ahead.p[0] == pytest.approx(1.0 + 0.5 * 0.3 / 12.0)


@pytest.mark.parametrize("size", [0.6, 1e4, 1e30])
def test_the_norm_of_its_force_is_limited_and_its_direction_kept(size):
    law = asked(lambda own, neighbours, world, t: size * np.array([0.6, -0.8]))
    force, _ = law.rate(np.zeros(0), OWN, OTHERS, WORLD, 0.0)
    np.testing.assert_allclose(force, 0.5 * np.array([0.6, -0.8]), rtol=1e-12)


def test_the_bits_of_a_law_that_limits_its_own_force_are_kept():
    rng = np.random.default_rng(4)
    for _ in range(200):
        wanted = bounded(rng.uniform(-9.0, 9.0, 2), OWN.max_force)
        law = asked(lambda own, neighbours, world, t, wanted=wanted: wanted)
        force, _ = law.rate(np.zeros(0), OWN, OTHERS, WORLD, 0.0)
        assert force.tolist() == wanted.tolist()


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_a_force_that_is_no_number_stays_one_for_the_error(bad):
    law = asked(lambda own, neighbours, world, t: np.array([bad, 0.0]))
    force, _ = law.rate(np.zeros(0), OWN, OTHERS, WORLD, 0.0)
    assert not np.isfinite(force).all()


@pytest.mark.parametrize(
    ("step", "calls"), [(0.02, 5), (0.1, 1), (1e9, 1), (1e-320, 100), (np.float32(0.05), 2)]
)
def test_it_is_asked_every_step_but_at_least_once_a_period(step, calls):
    times = []

    def force(own, neighbours, world, t):
        times.append(t)
        return 0.0 * own.p

    asked(force, step_s=step).propagate(np.zeros(0), OWN, OTHERS, WORLD, 0.0, 0.1, 100)
    assert len(times) == calls


@pytest.mark.parametrize("step", ["fast", None, True, 0.0, -0.1, math.nan, math.inf, [0.1]])
def test_a_step_that_is_no_time_is_refused(step):
    with pytest.raises(UnusableLawError, match="step_s: a time in seconds"):
        asked(lambda own, neighbours, world, t: own.p, step_s=step)


@pytest.mark.parametrize("size", ["two", None, -1, 1.5])
def test_a_message_of_no_size_is_refused(size):
    with pytest.raises(UnusableLawError, match="message_size: a whole number"):
        asked(lambda own, neighbours, world, t: own.p, message_size=size)
