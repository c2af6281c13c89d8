"""Cameras with a planted fault are caught, by the check that is for it."""

import threading
from collections import deque

import pytest
from msgspec.structs import replace

from test_plugins import with_cameras
from testbed.conformance import CamerasBench, PoseSourceConformance, check, pose_source
from testbed.conformance.check import NotConformingError
from testbed.mocap.exposure import Exposure
from testbed.realtime.wall_clock import monotonic_ns


@pytest.fixture(autouse=True)
def soon(monkeypatch):
    """What never comes is not waited for as long."""
    monkeypatch.setattr(pose_source, "LOOKS", 20)
    monkeypatch.setattr(check, "PATIENCE_S", 0.3)


class Source:
    """Cameras in the same process, as good as can be; the faults are put in below."""

    def __init__(self):
        self.frames, self.known, self.newest = deque(), set(), -1

    def send(self, number, bodies):
        self.frames.append((number, monotonic_ns(), bodies))

    def poll(self):
        found = []
        while self.frames:
            one = self.take(*self.frames.popleft())
            if one is not None:
                found.append(one)
        return found

    def take(self, number, at, bodies):
        if 0 <= self.newest - number < 100:
            return None
        self.newest = number
        self.known |= bodies.keys()
        seen = {n: self.look(bodies.get(n, pose_source.LOST)) for n in self.known}
        return Exposure(number, at, at, seen)

    def look(self, body):
        fine = all(abs(x) < 1e4 for x in (*body.position, *body.rotation))
        return body if fine else pose_source.LOST

    def close(self):
        pass


class Waits(Source):
    def poll(self):
        while not self.frames and not self.over.wait(0.01):
            pass
        return super().poll()

    def __init__(self):
        super().__init__()
        self.over = threading.Event()

    def close(self):
        self.over.set()


class TurnsThem(Source):
    def look(self, body):
        seen = super().look(body)
        return replace(seen, rotation=(*seen.rotation[3:], *seen.rotation[:3]))


class StampsOfAnotherClock(Source):
    def take(self, number, at, bodies):
        return super().take(number, at - 10**15, bodies)


class ExposedAfterArrival(Source):
    def take(self, number, at, bodies):
        one = super().take(number, at, bodies)
        return one and replace(one, exposed_ns=at + 5_000_000)


class LetsThemOvertake(Source):
    def take(self, number, at, bodies):
        self.newest = -1
        return super().take(number, at, bodies)


class GoesDeaf(Source):
    def take(self, number, at, bodies):
        return super().take(number, at, bodies) if number > self.newest else None


class KeepsTheLost(Source):
    def __init__(self):
        super().__init__()
        self.last = {}

    def take(self, number, at, bodies):
        self.last |= {n: body for n, body in bodies.items() if body.tracked}
        return super().take(number, at, self.last)


class LeavesOutTheLost(Source):
    def take(self, number, at, bodies):
        self.known = set()
        return super().take(number, at, {n: b for n, b in bodies.items() if b.tracked})


class LetsThemThrough(Source):
    def look(self, body):
        return body


class KeepsTheNewest(Source):
    def poll(self):
        return super().poll()[-1:]


class Raises(Source):
    def poll(self):
        raise OSError("the cable")


BAD = {  # source: (the check, what it says)
    Waits: ("silent_cameras_are_not_waited_for", "to return at once"),
    TurnsThem: ("bodies_are_where_the_cameras_see_them", "Rigid Body 4|sat1"),
    StampsOfAnotherClock: ("stamps", "arrived_ns"),
    ExposedAfterArrival: ("stamps", "arrived_ns - exposed_ns"),
    LetsThemOvertake: ("no_frame_after_a_newer_one", "number"),
    GoesDeaf: ("cameras_that_start_again_are_heard", "frame 59"),
    KeepsTheLost: ("a_body_that_is_lost_is_said_to_be", "True, True, True"),
    LeavesOutTheLost: ("a_body_that_is_lost_is_said_to_be", "None"),
    LetsThemThrough: ("what_is_no_number_is_not_tracked", "finite numbers"),
    KeepsTheNewest: ("many_frames_at_once", "50 exposures"),
    Raises: ("silent_cameras_are_not_waited_for", "OSError: the cable"),
}


def suite(kind):
    def make():
        source = kind()
        return CamerasBench(source, source.send)

    return type("Suite", (PoseSourceConformance,), {"make": make})()


@pytest.mark.parametrize("bad", BAD, ids=lambda bad: bad.__name__)
def test_it_is_caught(bad):
    name, words = BAD[bad]
    with pytest.raises(NotConformingError, match=words):
        getattr(suite(bad), f"test_{name}")()


def test_what_they_are_planted_in_conforms():
    check.run_all(suite(Source))


def test_cameras_that_die_of_rubbish_are_caught():
    def make():
        bench = with_cameras()
        take, bench.source._exposure = bench.source._exposure, None
        bad = bench.source

        def poll():
            found = type(bad).poll(bad)
            if bad.bad:
                raise ValueError("not JSON")
            return found

        bad._exposure, bad.poll = take, poll
        return bench

    one = type("Suite", (PoseSourceConformance,), {"make": make})()
    with pytest.raises(NotConformingError, match="not JSON"):
        one.test_rubbish_does_no_harm()


def test_a_port_that_is_not_given_back_is_caught():
    """The second of two sources at one port cannot open it."""
    taken = []

    def make():
        if taken:
            raise OSError("Address already in use")
        taken.append(Source())
        return CamerasBench(taken[0], taken[0].send)

    one = type("Suite", (PoseSourceConformance,), {"make": make})()
    with pytest.raises(OSError, match="already in use"):
        one.test_closed_and_opened_again()
