"""A law in plain Python: what it gets is read-only, its force is limited, its step is a time."""

import math
import re
from fractions import Fraction
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from controllers.law_file import UnusableLawError
from controllers.plain_law import PlainLaw, Watched
from testbed.core.error import TestbedError
from testbed.core.law import Ahead, Body, Discs, Goal, Neighbours, World, bounded

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


# What its functions return

NO_NUMBERS = {  # what is returned instead of two numbers: part of the hint
    "text": "instead of text",
    "numbers as text": "instead of text",
    "booleans": "instead of True and False",
    "None": "end the function with `return`",
    "None in a list": "return numbers",
    "complex": "take the real part",
    "NaN": "a division by zero",
    "infinite": "a division by zero",
    "a dictionary": "return numbers",
    "ragged": "the same length",
    "three": None,
    "a column": None,
    "one number": None,
}
RETURNED = {
    "text": "left", "numbers as text": ["0.1", "0.2"], "booleans": np.array([True, False]),
    "None": None, "None in a list": [None, 0.0], "complex": [1j, 0.0],
    "NaN": np.array([0.0, math.nan]), "infinite": [math.inf, 0.0], "a dictionary": {"x": 1.0},
    "ragged": [[1.0], [1.0, 2.0]], "three": np.zeros(3), "a column": np.zeros((2, 1)),
    "one number": 0.5,
}  # fmt: skip
SAYS = {
    "initial": "the law's state", "jump": "the law's state after the jump",
    "broadcast": "a message", "force": "a force [N]", "rate": "the rate of the law's state",
}  # fmt: skip


def watched(**answers):
    """A law with a state of two numbers and a message of two, and these answers instead."""
    said = dict.fromkeys(("initial", "force", "rate", "jump", "broadcast"), np.zeros(2)) | answers
    made = SimpleNamespace(
        initial=lambda own, neighbours, world: said["initial"],
        rate=lambda law_state, own, neighbours, world, t: (said["force"], said["rate"]),
        jump=lambda law_state, own, neighbours, world, t: said["jump"],
        broadcast=lambda law_state, own, neighbours, world, t: said["broadcast"],
        message_size=2,
    )
    return Watched(PlainLaw(made, Path(__file__)), Path(__file__))


@pytest.mark.parametrize("verb", ["force", "rate", "initial", "jump", "broadcast"])
@pytest.mark.parametrize("bad", NO_NUMBERS)
def test_what_is_no_array_of_numbers_is_an_error_that_names_the_function(verb, bad):
    if verb == "initial" and bad == "three":
        return  # a state may have any length
    law = watched(**{verb: RETURNED[bad]})
    with pytest.raises(TestbedError) as caught:
        law.try_out(OWN, OTHERS, WORLD)
    error = caught.value
    function = "rate" if verb == "force" else verb
    assert re.fullmatch(rf"test_plain_law.py:\d+, in {function}( at \S+ s)?", error.where)
    shape = "(n,)" if verb == "initial" else "(2,)"
    assert error.expected == f"{SAYS[verb]}: finite real numbers of shape {shape}"
    told = " ".join(repr(RETURNED[bad]).split())
    assert told in error.found
    assert error.hint
    assert (NO_NUMBERS[bad] or "") in error.hint
    assert "\n" not in str(error)  # the fault of a flight is one line
    assert str(error) == (
        f"{error.where}: expected {error.expected}, found {error.found}; {error.hint}"
    )


@pytest.mark.parametrize("both", [None, np.zeros(2), (np.zeros(2),), 3.0])
def test_a_rate_that_is_no_pair_is_refused(both):
    made = SimpleNamespace(rate=lambda law_state, own, neighbours, world, t: both)
    with pytest.raises(TestbedError, match=r"a force .N. and the rate of the law's state"):
        Watched(PlainLaw(made, None), None).try_out(OWN, OTHERS, WORLD)


@pytest.mark.parametrize(
    "force", [[1, 0], (0.25, np.float32(0.5)), np.array([1, 2]), [Fraction(1, 2), 0]]
)
def test_numbers_of_any_kind_are_a_force(force):
    law = asked(lambda own, neighbours, world, t: force, step_s=1.0)
    found, _ = law.rate(np.zeros(0), OWN._replace(max_force=9.0), OTHERS, WORLD, 0.0)
    assert found.tolist() == [float(one) for one in force]


def test_the_state_of_a_law_with_a_force_changes_by_its_jumps_only():
    made = SimpleNamespace(
        initial=lambda own, neighbours, world: np.ones(1),
        force=lambda own, neighbours, world, t: np.zeros(2),
    )
    law = PlainLaw(made, None)
    ahead = law.propagate(np.ones(1), OWN, OTHERS, WORLD, 0.0, 1.0, 4)
    assert ahead.law_state.tolist() == [1.0]


@pytest.mark.parametrize("part", Ahead._fields)
def test_a_law_with_its_own_propagate_is_looked_at_too(part):
    whole = Ahead(np.zeros(1), np.zeros(2), np.zeros(2), np.zeros(2), np.zeros(0))
    made = SimpleNamespace(
        message_size=0,
        initial=lambda own, neighbours, world: np.zeros(1),
        rate=lambda law_state, own, neighbours, world, t: (np.zeros(2), np.zeros(1)),
        propagate=lambda *_: whole._replace(**{part: np.full(5, math.nan)}),
    )
    with pytest.raises(TestbedError, match=f"expected `{part}` of its `Ahead`"):
        Watched(made, None).try_out(OWN, OTHERS, WORLD)
    made.propagate = lambda *_: None
    with pytest.raises(TestbedError, match=r"expected an `Ahead` of testbed.core.law, found None"):
        Watched(made, None).try_out(OWN, OTHERS, WORLD)


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


def test_a_message_of_a_size_without_a_function_is_refused():
    with pytest.raises(UnusableLawError, match="a method broadcast"):
        asked(lambda own, neighbours, world, t: own.p, message_size=2)
