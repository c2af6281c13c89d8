r"""Allocator: computes the duty of each jet for a wanted body wrench, with the least gas.

    minimise    sum_j thrust_j u_j - K1 s1 - K2 s2
    subject to  B u = s1 w1 + s2 w2,   0 <= u <= 1,   0 <= s <= 1

The wrench is split into the more important part, w2, and the rest, w1 (`priority`). K2 >> K1 >>
gas, so a feasible wrench is met exactly (s1 = s2 = 1); otherwise first w1 and then w2 is scaled
down without changing its direction. u = s = 0 is always feasible, so the answer always exists.

Three equations and ten bounded unknowns: a textbook bounded simplex method on 3 x 3 bases, with
Bland's rule against cycling. Opposing jets are never both open: the least-gas optimum of an
ideal layout never opens both, and if misaligned nozzles make it do so, one of the two is shut and
the problem is solved again.
"""

from collections.abc import Sequence
from functools import lru_cache
from typing import Literal, NamedTuple

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from testbed.core.compiled import compiled
from testbed.core.jets import effect_matrix, opposing_pairs
from testbed.core.scratch import scratch
from testbed.core.vehicle import Jet, Point, Vehicle

Array = NDArray[np.float64]

TINY = 1e-9
PIVOT = 1e-7  # a smaller pivot element would make the basis numerically singular
WORTH_LESS = 1e3  # K1, against a gas price of at most 1 per jet
WORTH_MORE = 1e6  # K2
DIRECTIONS = 360


class AllocatorParams(Struct, frozen=True, forbid_unknown_fields=True):
    """Which part of the wrench is kept when the jets cannot deliver both."""

    priority: Literal["torque", "force"] = "torque"  # a spinning vehicle pushes the wrong way


@compiled
def invert_3x3(m, inv):
    """Write the inverse of a 3 x 3 matrix to `inv`, by cofactors."""
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        for a in range(3):
            b, c = (a + 1) % 3, (a + 2) % 3
            inv[a, i] = m[j, b] * m[k, c] - m[j, c] * m[k, b]
    inv /= m[0, 0] * inv[0, 0] + m[0, 1] * inv[1, 0] + m[0, 2] * inv[2, 0]


@compiled
def simplex(columns, cost, upper, basis):
    """Minimise cost @ x over columns @ x = 0, 0 <= x <= upper, starting at x = 0.

    Args:
        columns: shape (3, n); the three at `basis` are the identity and fixed at zero.
        cost: shape (n,).
        upper: shape (n,).
        basis: indices of the first basis, shape (3,), written to.

    Returns:
        x, shape (n,).
    """
    n = columns.shape[1]
    x = np.zeros(n)
    basic = np.zeros(n, dtype=np.bool_)
    for i in range(3):
        basic[basis[i]] = True
    base, inverse, price, move = scratch((3, 3)), scratch((3, 3)), scratch(3), scratch(3)
    for iteration in range(60 * n):
        for i in range(3):
            base[:, i] = columns[:, basis[i]]
        invert_3x3(base, inverse)
        for i in range(3):
            price[i] = 0.0
            for k in range(3):
                price[i] += cost[basis[k]] * inverse[k, i]
        # entering variable: steepest at first, later Bland's smallest index, against cycling
        entering, best, sign = -1, TINY, 1.0
        for j in range(n):
            if basic[j] or upper[j] == 0.0:
                continue
            slope = cost[j]
            for i in range(3):
                slope -= price[i] * columns[i, j]
            gain = -slope if x[j] == 0.0 else slope
            if gain > best * max(1.0, abs(cost[j])):
                entering, sign = j, 1.0 if x[j] == 0.0 else -1.0
                if iteration > 4 * n:
                    break
                best = gain / max(1.0, abs(cost[j]))
        if entering < 0:
            break
        # ratio test: how far until the entering variable or a basic one meets a bound
        step, leaving = upper[entering], -1
        for i in range(3):
            move[i] = 0.0
            for k in range(3):
                move[i] -= sign * inverse[i, k] * columns[k, entering]
            if move[i] < -PIVOT:
                room = x[basis[i]] / -move[i]
            elif move[i] > PIVOT:
                room = (upper[basis[i]] - x[basis[i]]) / move[i]
            else:
                continue
            tie = leaving >= 0 and room == step
            if tie and iteration > 4 * n:
                tie = basis[i] < basis[leaving]
            elif tie:
                tie = abs(move[i]) > abs(move[leaving])
            if room < step or tie:
                step, leaving = max(0.0, room), i
        for i in range(3):
            b = basis[i]
            x[b] = min(upper[b], max(0.0, x[b] + step * move[i]))
        if leaving < 0:
            x[entering] = upper[entering] if sign > 0.0 else 0.0
            continue
        x[entering] += sign * step
        out = basis[leaving]
        x[out] = 0.0 if move[leaving] < 0.0 else upper[out]
        basic[out] = False
        basic[entering] = True
        basis[leaving] = entering
    return x


@compiled
def duties(effect, gas, ceiling, wrench, torque_first):
    """Solve the allocation problem of the module's first lines.

    Args:
        effect: B, shape (3, n).
        gas: price of each jet, shape (n,).
        ceiling: largest duty of each jet, shape (n,).
        wrench: wanted (fx, fy, tau).
        torque_first: whether the torque is w2 and the force w1, or the other way round.

    Returns:
        duty, shape (n,).
    """
    n = effect.shape[1]
    # scale the rows, so that tolerances are the same for newtons and newton metres
    columns, cost, upper = scratch((3, n + 5)), scratch(n + 5), scratch(n + 5)
    columns[:], cost[:], upper[:] = 0.0, 0.0, 0.0
    for i in range(3):
        scale = 0.0
        for j in range(n):
            scale = max(scale, abs(effect[i, j]))
        scale = 1.0 / scale if scale > 0.0 else 1.0
        for j in range(n):
            columns[i, j] = effect[i, j] * scale
        part = n + 1 if torque_first == (i == 2) else n
        columns[i, part] = -wrench[i] * scale
        columns[i, n + 2 + i] = 1.0
    dearest = np.max(gas)
    for j in range(n):
        cost[j], upper[j] = gas[j] / dearest, ceiling[j]
    for j, worth in (
        (n, WORTH_LESS),
        (n + 1, WORTH_MORE),
    ):  # s |w| instead of s: columns of length 1
        length = np.sqrt(columns[0, j] ** 2 + columns[1, j] ** 2 + columns[2, j] ** 2)
        if length > 0.0:
            for i in range(3):
                columns[i, j] /= length
            cost[j] = -worth
            upper[j] = length
    return simplex(columns, cost, upper, np.array([n + 2, n + 3, n + 4]))[:n]


@compiled
def one_sided(effect, gas, share, wrench, torque_first, opposing):
    """`duties` at this share of each thrust; no pair of `opposing` (n, 2) has both jets open."""
    weakened, ceiling = scratch(effect.shape), scratch(effect.shape[1])
    for j in range(effect.shape[1]):
        ceiling[j] = 1.0
        for i in range(3):
            weakened[i, j] = effect[i, j] * share[j]
    while True:
        duty = duties(weakened, gas, ceiling, wrench, torque_first)
        shut = -1
        for n in range(opposing.shape[0]):
            i, j = opposing[n]
            if min(duty[i], duty[j]) > TINY:
                shut = i if duty[i] < duty[j] else j
                break
        if shut < 0:
            return duty
        ceiling[shut] = 0.0


class Jets(NamedTuple):
    """A vehicle's jets for compiled code."""

    effect: Array  # B, shape (3, jets), see jets.py
    gas: Array  # price of each, shape (jets,)
    opposing: NDArray[np.int64]  # pairs that push against each other, shape (n, 2)
    torque_first: bool


def jets_of(params: AllocatorParams, vehicle: Vehicle) -> Jets:
    """The jets of a vehicle file."""
    numbers = in_numbers(vehicle.jets, vehicle.com)
    return Jets(*numbers, params.priority == "torque")


@compiled
def allocate(p, wrench, share):
    """Duty of each jet in [0, 1] without droop, shape (jets,).

    Args:
        p: Jets.
        wrench: wanted mean (fx, fy, tau) over the period, torque about the centre of mass.
        share: of its thrust that a command adds to each jet, shape (jets,); 0: it is not used.
    """
    return one_sided(p.effect, p.gas, share, wrench, p.torque_first, p.opposing)


@compiled
def weakest(effect, gas, opposing, directions, plenty):
    """Smallest force [N] over equally spaced directions of a demand of `plenty` without torque."""
    least, all_of_it = np.inf, np.ones(gas.shape[0])
    for k in range(directions):
        angle = 2.0 * np.pi * k / directions
        wrench = plenty * np.cos(angle), plenty * np.sin(angle), 0.0
        duty = one_sided(effect, gas, all_of_it, wrench, True, opposing)
        fx = fy = 0.0
        for j in range(duty.shape[0]):
            fx += effect[0, j] * duty[j]
            fy += effect[1, j] * duty[j]
        least = min(least, np.hypot(fx, fy))
    return least


def in_numbers(jets: Sequence[Jet], about: Point) -> tuple[Array, Array, NDArray[np.int64]]:
    """B (3, jets), price of each jet (jets,), pairs that push against each other (n, 2)."""
    return (
        effect_matrix(jets, about),
        np.array([jet.thrust for jet in jets]),
        np.array(opposing_pairs(jets), dtype=np.int64).reshape(-1, 2),
    )


def weakest_force(vehicle: Vehicle) -> float:
    """Largest force of the jets in their weakest direction without a torque [N].

    DIRECTIONS equally spaced directions are tried; for jets along a few axes the force between two
    of them is hardly less.
    """
    return _weakest_of(tuple(vehicle.jets), vehicle.com)


@lru_cache(maxsize=64)
def _weakest_of(jets: tuple[Jet, ...], com: Point) -> float:
    """The same, cached: each flight chain and each run of a campaign needs it several times."""
    effect, gas, opposing = in_numbers(jets, com)
    return weakest(effect, gas, opposing, DIRECTIONS, 2.0 * gas.sum())
