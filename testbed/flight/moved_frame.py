"""Whether one motion of the cameras' frame explains where several vehicles are seen.

A vehicle alone may have been swapped, or its markers may have moved. A single shift and turn that
takes every vehicle from where it was expected to where it is seen leaves no room for that: each
vehicle beyond the first one adds three equations and no unknown.
"""

import cmath
import math
from collections.abc import Sequence
from typing import NamedTuple

from testbed.core.se2 import wrap
from testbed.core.types import PoseSample, State

SURE = 0.0015  # of an expected place: noise, and the jets since the last estimate [m]
SHARE = 0.15  # of the largest step that may stay unexplained
MOST = 0.02  # and at most this [m]
TURNED = 0.05  # headings may differ from the turn of the places by this [rad]
CLEAR = 2.0  # a vehicle has moved by more than so many times what may stay unexplained
APART = 0.3  # vehicles at least so far apart show a turn [m]
LATE = 0.05, 2.0  # delays of poses that are told from a step [s]
FACTOR = 0.005  # smallest change of scale


class Sight(NamedTuple):
    """Where a vehicle was expected, and where the cameras see it."""

    expected: complex  # x + i y [m]
    seen: complex  # [m]
    heading: float  # expected [rad]
    turn: float  # from it to the heading that is seen [rad]
    going: complex  # velocity [m/s]

    @property
    def step(self) -> complex:
        """From the expected place [m]."""
        return self.seen - self.expected


def sight_of(state: State, pose: PoseSample) -> Sight:
    """The sight of a pose, by an estimate of a little earlier or later."""
    ahead, pace = pose.captured_at - state.t, state.twist
    going = complex(pace.vx, pace.vy)
    heading = state.pose.theta + ahead * pace.omega
    expected = complex(state.pose.x, state.pose.y) + ahead * going
    return Sight(expected, complex(pose.x, pose.y), heading, wrap(pose.theta - heading), going)


def how_moved(seen: Sequence[Sight], *, swapped: bool = False) -> str:
    """How the frame has moved, for a person; empty: no single motion explains the sights.

    Args:
        seen: of all vehicles, by the same camera frames.
        swapped: a vehicle is where another one should be. That needs a third vehicle to refute.
    """
    if len(seen) < 2 + swapped:
        return ""
    far = max(abs(one.step) for one in seen)
    loose = min(MOST, max(SURE, SHARE * far))
    moved = [one for one in seen if abs(one.step) > CLEAR * loose]
    if len(moved) < 2 + swapped or _late(seen, loose):
        return ""
    who = f"{len(seen)} vehicles are seen elsewhere at once"
    turn = _turn(seen)
    if abs(turn) < TURNED and _fits(seen, 0.0, loose):
        return f"{who}, all by {1e3 * abs(_shift(seen, 0.0)):.0f} mm"
    if _fits(seen, turn, loose):
        shift = abs(_shift(seen, turn))
        return f"{who}, by a turn of {math.degrees(turn):.1f} deg and a shift of {shift:.2f} m"
    factor = _factor(seen)
    straight = all(abs(one.turn) < TURNED for one in seen)
    off = max(abs(one.seen - factor * one.expected) for one in seen)
    if straight and abs(factor - 1.0) > FACTOR and off <= loose * max(1.0, abs(factor)):
        return f"{who}, all {factor:.4g} times as far from the origin"
    return f"{who}, all on a line and with one heading" if _on_a_line(seen, loose) else ""


def _mean(numbers: Sequence[complex]) -> complex:
    return sum(numbers) / len(numbers)


def _turn(seen: Sequence[Sight]) -> float:
    """The turn that fits the places best; of vehicles that are close together, the headings [rad].

    The best one has the phase of the sum of conj(p) q over places p and q about their means.
    """
    p, q = _mean([one.expected for one in seen]), _mean([one.seen for one in seen])
    if max(abs(one.expected - p) for one in seen) > 0.5 * APART:
        found = sum((one.expected - p).conjugate() * (one.seen - q) for one in seen)
        if found:
            return cmath.phase(found)
    return cmath.phase(sum(cmath.exp(1j * one.turn) for one in seen) or 1.0)


def _shift(seen: Sequence[Sight], turn: float) -> complex:
    """What is left of the steps after a turn about the origin, on average [m]."""
    return _mean([one.seen - cmath.exp(1j * turn) * one.expected for one in seen])


def _fits(seen: Sequence[Sight], turn: float, loose: float) -> bool:
    """Whether a turn and a shift explain all places and headings."""
    shift, by = _shift(seen, turn), cmath.exp(1j * turn)
    return all(
        abs(one.seen - by * one.expected - shift) <= loose and abs(wrap(one.turn - turn)) <= TURNED
        for one in seen
    )


def _factor(seen: Sequence[Sight]) -> float:
    """The scale about the origin that fits the places best."""
    square = sum(abs(one.expected) ** 2 for one in seen)
    return sum((one.expected.conjugate() * one.seen).real for one in seen) / max(square, 1e-12)


def _on_a_line(seen: Sequence[Sight], loose: float) -> bool:
    """Whether all are seen with one x or one y and one heading, and were not expected so."""
    x, y = [one.seen.real for one in seen], [one.seen.imag for one in seen]
    headings = [one.heading + one.turn for one in seen]
    flat = min(max(x) - min(x), max(y) - min(y)) <= loose
    same = all(abs(wrap(one - headings[0])) <= TURNED for one in headings)
    return flat and same and all(abs(one.step) > CLEAR * loose for one in seen)


def _late(seen: Sequence[Sight], loose: float) -> bool:
    """Whether one delay of all poses explains the steps: vehicles are seen where they were."""
    square = sum(abs(one.going) ** 2 for one in seen)
    if square == 0.0:
        return False
    late = -sum((one.step * one.going.conjugate()).real for one in seen) / square
    return LATE[0] < late < LATE[1] and all(
        abs(one.step + late * one.going) <= loose for one in seen
    )
