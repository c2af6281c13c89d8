"""A clock that keeps step with another: absolute deadlines, lateness read after waking."""

import time

import pytest

from testbed.realtime.pacer import PacedClock


class Wall:
    """A wall clock whose sleeps are too long by `over`, and sometimes too short."""

    def __init__(self, over: float) -> None:
        self.t, self.over, self.sleeps = 100.0, over, 0

    def now(self) -> float:
        return self.t

    def sleep(self, seconds: float) -> None:
        self.sleeps += 1
        self.t += 0.5 * seconds if self.sleeps % 3 == 0 else seconds + self.over


class Virtual:
    def __init__(self) -> None:
        self.times: list[float] = []

    def wait_until(self, t: float) -> None:
        self.times.append(t)


@pytest.mark.parametrize("speed", [0.5, 1.0, 20.0])
def test_deadlines_are_absolute(speed):
    wall, inner = Wall(0.003), Virtual()
    pace = PacedClock(inner, speed, wall.now, wall.sleep)
    for k in range(200):
        pace.wait_until(0.1 * k)
        assert 0.0 <= pace.late_s <= 0.003 + 1e-9
    assert inner.times == [0.1 * k for k in range(200)]
    assert wall.t - 100.0 == pytest.approx(0.1 * 199 / speed, abs=0.004)  # no drift


def test_a_tick_that_takes_too_long_is_late_and_the_next_is_not():
    wall = Wall(0.0)
    pace = PacedClock(Virtual(), 1.0, wall.now, wall.sleep)
    pace.wait_until(0.0)
    wall.t += 0.15
    assert pace.busy_s == pytest.approx(0.15)
    pace.wait_until(0.1)
    assert pace.late_s == pytest.approx(0.05)
    pace.wait_until(0.2)
    assert pace.late_s == pytest.approx(0.0)


def test_time_0_is_when_the_first_tick_was_due():
    pace = PacedClock(Virtual(), 1e6)
    assert pace.began_ns is None
    before = time.time_ns()
    pace.wait_until(0.0)
    after = time.time_ns()
    assert before - 1_000_000 <= pace.began_ns <= after + 1_000_000  # two clocks


def test_it_may_begin_in_the_middle():
    wall, inner = Wall(0.0), Virtual()
    pace = PacedClock(inner, 1.0, wall.now, wall.sleep)
    pace.wait_until(5.0)
    assert (wall.t, wall.sleeps) == (100.0, 0)
