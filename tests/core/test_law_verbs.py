"""A law that jumps and tells, compiled and in plain Python."""

from typing import NamedTuple

import numpy as np
import pytest

from controllers.plain_law import propagate_plain
from testbed.core.law import Body, CompiledLaw, Discs, Goal, Neighbours, World, propagate
from testbed.core.law_verbs import compiled_broadcast, compiled_jump, compiled_rate, write_rate


class Gains(NamedTuple):
    push: float


@compiled_rate(Gains)
def rate(gains, law_state, own, neighbours, world, t):
    """A push away from what the others told, carried on at 1 per second; the state stands."""
    force = np.zeros(own.p.shape[0])
    for n in range(neighbours.p.shape[0]):
        force[0] += gains.push * (neighbours.message[n, 0] + t - neighbours.message_t[n])
    return force, np.zeros(2)


@compiled_jump(Gains)
def jump(gains, law_state, own, neighbours, world, t):
    """Counts flights, and remembers who was there."""
    return np.array([law_state[0] + 1.0, float(neighbours.vehicle_index.sum())])


@compiled_broadcast(Gains)
def broadcast(gains, law_state, own, neighbours, world, t):
    return np.array([own.p[0], t, law_state[0], float(own.vehicle_index)])


class Plain:
    """The same in plain Python."""

    def rate(self, *args):
        return rate.py_func(Gains(2.0), *args)

    def jump(self, *args):
        return jump.py_func(Gains(2.0), *args)

    def broadcast(self, *args):
        return broadcast.py_func(Gains(2.0), *args)


class OnlyRate:
    def rate(self, law_state, own, neighbours, world, t):
        return np.zeros(2), np.zeros(2)


@pytest.fixture
def scene():
    still = np.zeros(2)
    own = Body(np.array([1.0, 0.0]), still, 2.0, still, still, 1e9, 3)
    others = Neighbours(
        np.zeros((2, 2)),
        np.zeros((2, 2)),
        np.zeros(2),
        np.array([1, 4]),
        np.array([[0.5], [0.25]]),
        np.array([9.0, 10.0]),
    )
    obstacles = Discs(np.zeros((0, 2)), np.zeros((0, 2)), np.zeros(0))
    return own, others, World(Goal(still, still, still, still), obstacles)


def fly_compiled(state, scene):
    return propagate(Gains(2.0), state, *scene, 10.0, 0.5, 2)


def fly_plain(state, scene):
    return propagate_plain(Plain(), state, *scene, 10.0, 0.5, 2)


@pytest.mark.parametrize("fly", [fly_compiled, fly_plain])
def test_a_law_jumps_first_and_tells_last(fly, scene):
    state = np.zeros(2)
    ahead = fly(state, scene)
    # told 0.5 one second ago and 0.25 now; a quarter of a second later each is that much more
    assert ahead.mean_force == pytest.approx([2.0 * (1.5 + 0.25 + 0.25), 0.0])
    assert list(ahead.law_state) == [1.0, 5.0]
    assert list(state) == [0.0, 0.0]
    assert list(ahead.message) == [ahead.p[0], 10.5, 1.0, 3.0]


def test_a_law_needs_no_more_than_a_rate(scene):
    ahead = propagate_plain(OnlyRate(), np.ones(2), *scene, 0.0, 1.0, 4)
    assert list(ahead.law_state) == [1.0, 1.0]
    assert ahead.message.shape == (0,)


class Returned(NamedTuple):
    stiffness: float


class Written(NamedTuple):
    stiffness: float


class Forgotten(NamedTuple):
    stiffness: float


@compiled_rate(Returned)
def returned(gains, law_state, own, neighbours, world, t):
    return law_state - gains.stiffness * own.p, own.v + t


@compiled_rate(Written)
def written(gains, law_state, own, neighbours, world, t, force, change):
    for i in range(force.shape[0]):
        force[i] = law_state[i] - gains.stiffness * own.p[i]
        change[i] = own.v[i] + t


@compiled_rate(Forgotten)
def forgotten(gains, law_state, own, neighbours, world, t, force, change):
    force[0] = 1.0


@pytest.mark.parametrize("fly", [propagate, propagate_plain])
def test_a_law_that_writes_its_rate_is_the_one_that_returns_it(fly, scene):
    state = np.array([0.3, -0.2])
    one, other = (fly(kind(0.7), state, *scene, 1.0, 0.5, 50) for kind in (Returned, Written))
    assert [x.tobytes() for x in one] == [x.tobytes() for x in other]
    assert one.law_state[0] != state[0]


def test_a_rate_that_writes_is_asked_like_any_other(scene):
    state = np.array([0.3, -0.2])
    laws = (CompiledLaw(Returned(0.7), None, returned), CompiledLaw(Written(0.7), None, written))
    one, other = (law.rate(state, *scene, 1.0) for law in laws)
    np.testing.assert_array_equal(one, other)
    force, change = np.empty(2), np.empty(2)
    write_rate(laws[0].gains, state, *scene, 1.0, force, change)
    np.testing.assert_array_equal((force, change), one)


def test_what_a_rate_does_not_write_is_no_number(scene):
    """`testbed check` asks for the rate, and refuses NaN."""
    law = CompiledLaw(Forgotten(1.0), None, forgotten)
    force, change = law.rate(np.zeros(2), *scene, 0.0)
    assert (force[0], np.isnan(force[1]), np.isnan(change).all()) == (1.0, True, True)


@pytest.mark.parametrize("names", ["gains, own, t", "g, z, own, others, world, t, out, change"])
def test_a_rate_with_other_arguments_is_refused(names):
    here = {}
    exec(f"def rate({names}): pass", here)
    with pytest.raises(TypeError, match=f"or with force and change after them, found .{names}"):
        compiled_rate(Written)(here["rate"])
