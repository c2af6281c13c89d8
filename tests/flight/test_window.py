"""The sums of a window of looks, and what they say of each cause, against sums written out."""

import numpy as np
import pytest

from testbed.flight.hypotheses import ALL, COLUMNS, PULL, PUSHED, THRUST, X, Y
from testbed.flight.record import record
from testbed.flight.window import (
    BLOCKS,
    SHARED,
    VERDICT,
    Window,
    age,
    clear,
    decide,
    factor,
    forget,
    listen,
    suspect,
)

JETS, KEEP = 5, 0.97
M = JETS + SHARED
ROWS = M + JETS + 3  # some causes beside the jets
SUSPECTS = [*range(JETS), *range(M, ROWS)]


def empty():
    shapes = [(M, M + 1), (BLOCKS, M + 2, len(SUSPECTS)), (BLOCKS,), (1,), (2,), (3,)]
    window = Window(*map(np.zeros, shapes))
    window.spread[:] = 1.0, 4.0
    return window


def heard(window, looks, block):
    """Listen to random looks, a block every so many; the looks, weighted and forgotten."""
    rng, sums = np.random.default_rng(3), []
    for k in range(looks):
        if k % block == 0:
            age(window, 0)
        x = rng.normal(size=(3, ROWS + 1))
        listen(window, x, 0.0, KEEP, 0.5, 2.6)  # the noise stays as it is
        weight = np.array([1.0 / 1.5, 1.0 / 1.5, 1.0 / 4.0])[:, None]
        sums = [KEEP * one for one in sums] + [x.T @ (weight * x)]
    return sums


@pytest.mark.parametrize("looks", [7, 60, 200])  # within the blocks, and far beyond all of them
def test_blocks_have_what_was_heard_since_they_began(looks):
    window, block = empty(), 4
    sums = heard(window, looks, block)
    assert window.normal == pytest.approx(sum(sums)[:M][:, [*range(M), -1]])
    now, began = int(window.newest[0]), (looks - 1) // block * block
    since = np.zeros((M + 2, len(SUSPECTS)))
    for k in range(BLOCKS):
        place = (now + k) % BLOCKS
        since += window.worth[place] * window.blocks[place]
        first = max(0, began - k * block) if k < BLOCKS - 1 else 0
        told = sum(sums[first:])
        assert since[:M] == pytest.approx(told[:M][:, SUSPECTS]), k
        assert since[M] == pytest.approx(np.diag(told)[SUSPECTS]), k
        assert since[M + 1] == pytest.approx(told[-1, SUSPECTS]), k


def test_a_window_that_was_cleared_begins_anew():
    window, fresh = empty(), empty()
    heard(window, 50, 4)
    clear(window)
    heard(window, 9, 3)
    heard(fresh, 9, 3)
    at, there = int(window.newest[0]), int(fresh.newest[0])
    for k in range(BLOCKS):
        one, other = (at + k) % BLOCKS, (there + k) % BLOCKS
        expected = fresh.worth[other] * fresh.blocks[other]
        assert window.worth[one] * window.blocks[one] == pytest.approx(expected)
    assert window.normal == pytest.approx(fresh.normal)


@pytest.mark.parametrize("after", [20, 40, 70])  # blocks from the fault to the end
def test_a_cause_that_began_later_keeps_its_beginning(after):
    """A hose against which the jets hold looks like a lack of thrust, but for its beginning."""
    healthy, pull, rng = 12, np.array([12e-3, 5e-3]), np.random.default_rng(6)
    rows, first = 2 * JETS + SHARED + COLUMNS, 2 * JETS + SHARED
    shapes = [(M, M + 1), (BLOCKS, M + 2, 2 * JETS + COLUMNS), (BLOCKS,), (1,), (2,), (3,)]
    window, found, began = Window(*map(np.zeros, shapes)), np.zeros(1, record(**VERDICT))[0], 0
    window.spread[:] = 1e-6, 25e-6
    for k in range(healthy + after):
        age(window, began)
        hose = pull if k >= healthy else np.zeros(2)
        push = 3e-3 * rng.normal(size=2) - hose
        x = np.zeros((3, rows + 1))
        x[:2, M - 2 : M] = x[:2, first + X : first + Y + 1] = np.eye(2)
        x[:2, first + ALL] = x[:2, first + PUSHED] = push
        x[:2, -1] = hose + 1e-3 * rng.normal(size=2)
        listen(window, x, 0.0, 0.975, 0.0, 2.6)
        forget(found)
        least, y = np.empty((M, M)), np.empty(M)
        factor(window.normal, np.full(M, 400.0), 1.0 / 4e-6, least, y)
        began = decide(window, least, y, 0.1, 1.0, True, found)
    assert began == min(after - 1, BLOCKS - 2)
    assert found.gains[PULL] > found.gains[THRUST] + 3.0
    assert found.way == pytest.approx(pull, abs=1e-3)


@pytest.mark.parametrize("m", [9, 10, 11, 12, 13, 21])  # of 4 to 16 jets
def test_suspicions_are_what_is_left_without_the_uncertain_parameters(m):
    rng = np.random.default_rng(4)
    z, x, e = rng.normal(size=(40, m)), rng.normal(size=(40, 11)), rng.normal(size=40)
    sure, slope = rng.uniform(1.0, 9.0, m), 0.3
    told = np.column_stack((z.T @ z, z.T @ e))
    least, y = np.empty((m, m)), np.empty(m)
    factor(told, sure, slope, least, y)
    since = np.vstack((z.T @ x, (x * x).sum(axis=0), x.T @ e))
    fits, own = np.empty(11), np.empty(11)
    suspect(since, least, y, np.empty((4, 11)), fits, own)
    sure[-2:] = slope
    inverse = np.linalg.inv(z.T @ z + np.diag(sure))
    left = np.eye(40) - z @ inverse @ z.T
    assert fits == pytest.approx(x.T @ left @ e)
    assert own == pytest.approx(np.diag(x.T @ left @ x))
