"""What the testbed requires of motion capture: right bodies and stamps, in order, no waiting."""

import math
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from itertools import pairwise
from typing import NamedTuple

from testbed.conformance.check import at_once, factory_of, must, run_all
from testbed.mocap.exposure import Exposure, MocapSource, Sighting
from testbed.realtime.wall_clock import monotonic_ns

LOOKS, LOOK_S = 1000, 0.01  # for a frame to arrive
CLOSE = 1e-4  # two numbers that are the same, in single precision
STEP = 0.01  # frame k shows its bodies at x = k STEP [m]
OLDEST_NS = 1_000_000_000  # from exposure to arrival, here
LOST = Sighting((0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0), tracked=False)
RUBBISH = (
    b"",
    b"\0",
    b"{",
    b"[]",
    b"null",
    b"\xff" * 40,
    b'{"bodies": 3}',
    b"[" * 5000,
    b"9" * 5000,
)


def nothing() -> None:
    """Nothing to do at the end."""


class CamerasBench(NamedTuple):
    """A plug-in, and simulated cameras that the checks control."""

    source: MocapSource
    send: Callable[[int, dict[str, Sighting]], None]  # a frame: its number, what it shows
    rubbish: Callable[[bytes], None] | None = None  # bytes where frames come in; None: cannot be
    close: Callable[[], None] = nothing  # of the cameras


class PoseSourceConformance:
    """Subclass it in a test file: `class TestMine(PoseSourceConformance): make = with_cameras`.

    Attributes:
        make: makes a `CamerasBench`.
    """

    make: Callable[..., CamerasBench]

    @contextmanager
    def _bench(self) -> Iterator[CamerasBench]:
        bench = factory_of(self)()
        try:
            yield bench
        finally:
            at_once("close", bench.source.close)
            bench.close()

    def test_silent_cameras_are_not_waited_for(self) -> None:
        """No frame: an empty list, at once."""
        with self._bench() as bench:
            for _ in range(3):
                found = at_once("poll of silent cameras", bench.source.poll)
                must(found == [], "poll of silent cameras", "[]", found)

    def test_bodies_are_where_the_cameras_see_them(self) -> None:
        """By their names, in the axes of the cameras."""
        half = math.sqrt(0.5)
        seen = {
            "sat1": Sighting((STEP, -0.25, 1.5), (half, 0.0, 0.0, half), tracked=True),
            "Rigid Body 4": Sighting((STEP, 2.0, 0.0), (0.0, 0.0, half, -half), tracked=True),
        }
        with self._bench() as bench:
            bench.send(1, seen)
            found = _until(bench, 1)[-1].bodies
        must(found.keys() == seen.keys(), "bodies", f"{sorted(seen)}", sorted(found))
        for name, body in seen.items():
            one = found[name]
            must(one.tracked, name, "a body that is tracked", "one that is not")
            pairs = zip(
                (*one.position, *one.rotation), (*body.position, *body.rotation), strict=True
            )
            same = all(abs(a - b) <= CLOSE for a, b in pairs)
            must(same, name, f"{body.position} and {body.rotation}", f"{one}")

    def test_stamps(self) -> None:
        """Times of this machine's monotonic clock: exposure before arrival before now, in order."""
        with self._bench() as bench:
            before = monotonic_ns()
            found: list[Exposure] = []
            for k in range(1, 21):
                bench.send(k, _at(k))
                found += _until(bench, k)
            now = monotonic_ns()
        for one in found:
            age, arrived = one.arrived_ns - one.exposed_ns, one.arrived_ns
            must(0 <= age <= OLDEST_NS, "arrived_ns - exposed_ns", "0 to 1 s", f"{age} ns")
            must(before <= arrived <= now, "arrived_ns", "the monotonic clock's time", arrived)
        _in_order(found)
        must(len(found) == 20, "20 frames one by one", "20 exposures", len(found))

    def test_no_frame_after_a_newer_one(self) -> None:
        """Networks let datagrams overtake each other, and say some twice."""
        with self._bench() as bench:
            for k in (1, 3, 2, 4, 4, 5):
                bench.send(k, _at(k))
            found = _until(bench, 5)
        _in_order(found)
        shown = [_frame_of(one) for one in found]
        expected = "frames in order, each once, and none lost but the overtaken one"
        must(shown in ([1, 3, 4, 5], [1, 2, 3, 4, 5]), "frames 1, 3, 2, 4, 4, 5", expected, shown)

    def test_cameras_that_start_again_are_heard(self) -> None:
        """After a restart of the camera program frames count from 1."""
        with self._bench() as bench:
            bench.send(100_000, _at(1))
            _until(bench, 1)
            for k in range(2, 60):
                bench.send(k, _at(k))
            found = _until(bench, 59)
        must(found, "frames counted from 1 after frame 100000", "some of 60", "none")

    def test_a_body_that_is_lost_is_said_to_be(self) -> None:
        """A lost body stays in the exposure as not tracked, until it is seen again."""
        with self._bench() as bench:
            other = {"other": Sighting((0.0, 1.0, 0.0), (0.0, 0.0, 0.0, 1.0), tracked=True)}
            for k, seen in ((1, True), (2, False), (3, True)):
                body = _at(k)["sat1"] if seen else LOST
                bench.send(k, {"sat1": body, **_named(other, k)})
            found = _until(bench, 3, "other")
        shown = [one.bodies["sat1"].tracked if "sat1" in one.bodies else None for one in found]
        expected = "sat1 tracked, not tracked, tracked"
        must(shown == [True, False, True], "a body lost in one of three frames", expected, shown)

    def test_what_is_no_number_is_not_tracked(self) -> None:
        """NaN and infinity never get through as a pose."""
        with self._bench() as bench:
            for k, bad in enumerate((math.nan, math.inf, -math.inf), 1):
                at = _at(k)["sat1"]
                for body in (
                    Sighting((at.position[0], bad, 0.0), at.rotation, tracked=True),
                    Sighting(at.position, (0.0, bad, 0.0, 1.0), tracked=True),
                ):
                    bench.send(k, {"sat1": body})
            bench.send(9, _at(9))
            found = _until(bench, 9)
        for one in found:
            for name, body in one.bodies.items():
                fine = all(map(math.isfinite, (*body.position, *body.rotation)))
                must(fine or not body.tracked, name, "finite numbers, or not tracked", body)

    def test_rubbish_does_no_harm(self) -> None:
        """Data that is not a frame is ignored, and the next frame is received."""
        with self._bench() as bench:
            if bench.rubbish is None:
                return
            for data in RUBBISH:
                bench.rubbish(data)
            bench.send(1, _at(1))
            found = _until(bench, 1)
        must(len(found) == 1, "rubbish and one frame", "one exposure", len(found))

    def test_many_frames_at_once(self) -> None:
        """A vehicle that was busy finds them all, in order."""
        with self._bench() as bench:
            for k in range(1, 51):
                bench.send(k, _at(k))
            found = _until(bench, 50)
        _in_order(found)
        must(len(found) == 50, "50 frames before a poll", "50 exposures", len(found))

    def test_closed_and_opened_again(self) -> None:
        """Closing releases ports, and may be called twice."""
        for k in (1, 2):
            with self._bench() as bench:
                bench.send(k, _at(k))
                _until(bench, k)
                at_once("close", bench.source.close)


def check_pose_source(factory: Callable[[], CamerasBench]) -> None:
    """All checks of `PoseSourceConformance`, without pytest.

    Raises:
        NotConformingError: the first that fails.
    """
    suite = PoseSourceConformance()
    suite.__dict__.update(make=factory)
    run_all(suite)


def _at(k: int) -> dict[str, Sighting]:
    """Positions of the bodies in frame k."""
    return {"sat1": Sighting((k * STEP, 0.5, 0.25), (0.0, 0.0, 0.0, 1.0), tracked=True)}


def _named(bodies: dict[str, Sighting], k: int) -> dict[str, Sighting]:
    return {
        name: Sighting((k * STEP, *body.position[1:]), body.rotation, tracked=True)
        for name, body in bodies.items()
    }


def _frame_of(one: Exposure, body: str = "sat1") -> int | None:
    seen = one.bodies.get(body)
    return None if seen is None or not seen.tracked else round(seen.position[0] / STEP)


def _until(bench: CamerasBench, k: int, body: str = "sat1") -> list[Exposure]:
    """All exposures up to frame k."""
    found: list[Exposure] = []
    for _ in range(LOOKS):
        found += at_once("poll", bench.source.poll)
        if any(_frame_of(one, body) == k for one in found):
            return found
        threading.Event().wait(LOOK_S)
    must(False, f"frame {k}", f"an exposure with it after {LOOKS} polls", f"{len(found)} others")
    return found


def _in_order(found: list[Exposure]) -> None:
    for one, after in pairwise(found):
        must(one.number < after.number, "number", f"more than {one.number}", after.number)
        later = one.exposed_ns <= after.exposed_ns and one.arrived_ns <= after.arrived_ns
        must(later, "exposed_ns and arrived_ns", "none before the exposure ahead of it", after)
