"""The calls of a law that is a file of the user's own: timed, and ended when they take too long.

A timer of the system interrupts a call that lasts longer than its limit and raises an error inside
the law, so that the run goes on to its proper end, as after any other error of a law. A law that
does not even hear that (it is in compiled code, or catches everything) is ended with its process,
by the one that looks after it: see `cli/process_supervisor.py`.

Only the first thread of a process can be interrupted: elsewhere, as in campaigns with threads,
nothing here does anything.
"""

import os
import signal
import statistics
import threading
import time
from array import array
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager, nullcontext
from types import FrameType
from typing import Any

import numba.core.compiler_lock as compiling

from controllers.law_file import LawStoppedError, UnusableLawError, file_of
from controllers.own_law import OwnLawParams
from controllers.plain_law import LawError
from testbed.core.law import Ahead, Array, Body, Concern, Law, Neighbours, World
from testbed.realtime.heartbeat import Phase, heartbeat

READ_S = 30.0  # reading a law's file: it may import large packages
FIRST_S = 10.0  # the first calls, before the flight; time in which numba compiles is not counted
HURRY_S = 0.5  # a call that goes on after the operator's stop
LOOKS = 4  # of the timer before the limit: a suspended process must not count as a hanging law
PAGE_MB = os.sysconf("SC_PAGE_SIZE") / 1e6
FEW = 3  # calls: fewer say nothing, and on wires a flight ends after as many slow ones

_open_watches: "list[LawWatch]" = []  # at most the one of this process


class LawWatch:
    """A context manager; the calls of one process's laws.

    Args:
        law: its name in the experiment, "my_law.py:Mine".
        limit_s: for one call [s].
        memory_mb: that all calls together may add to the process [MB].
        period_s: between two calls for a vehicle, for the words about a slow law [s].
    """

    def __init__(self, law: str, limit_s: float, memory_mb: float, period_s: float) -> None:
        path = file_of(law)
        self.name = law if path is None else path.name
        self.limit_s, self.memory_mb, self.period_s = limit_s, memory_mb, period_s
        self._now_s = limit_s  # the limit at present
        self._inside = False
        self._late, self._grown, self._entered_mb = 0, 0.0, 0.0
        self._forked = False
        self._stack = ExitStack()

    def __enter__(self) -> "LawWatch":
        self._threads = set(threading.enumerate())
        before = signal.signal(signal.SIGALRM, self._tick)
        self._stack.callback(signal.signal, signal.SIGALRM, before)
        self._stack.callback(signal.setitimer, signal.ITIMER_REAL, 0.0)
        statm = os.open("/proc/self/statm", os.O_RDONLY)
        self._stack.callback(os.close, statm)
        self._statm = statm
        heartbeat().law, heartbeat().limits = self.name, (self.limit_s, self.memory_mb)
        _open_watches.append(self)
        self._stack.callback(_open_watches.remove, self)
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()

    @contextmanager
    def allowing(self, limit_s: float) -> Iterator[None]:
        """Another limit for a call meanwhile [s]."""
        before, self._now_s = self._now_s, limit_s
        try:
            yield
        finally:
            self._now_s = before

    @contextmanager
    def call(self, vehicle: bytes) -> Iterator[None]:
        """A call of the law.

        Raises:
            LawError: it took too long or too much.
        """
        self._entered_mb = self._resident_mb()
        self._late, self._forked = 0, False
        heartbeat().enter(vehicle)
        self._inside = True
        signal.setitimer(signal.ITIMER_REAL, self._now_s / LOOKS, self._now_s / LOOKS)
        try:
            yield
        except LawStoppedError as error:  # between two lines of ours
            raise LawError(f"{self.name}: {error}") from None
        finally:
            self._inside = False
            signal.setitimer(signal.ITIMER_REAL, 0.0)
            heartbeat().leave()
        self._grown = self._with_this_call()
        if self._forked:
            raise LawError(f"{self.name}: started a process by os.fork(); a law must not")
        if self._grown > self.memory_mb:
            raise LawError(f"{self.name}: {self._too_much(self._grown)}")

    def left_running(self) -> str:
        """Words about threads that would keep the process from ending; empty: there are none."""
        left = [
            one.name for one in threading.enumerate()
            if one not in self._threads and not one.daemon
        ]  # fmt: skip
        count = "a thread" if len(left) == 1 else f"{len(left)} threads"
        return f"law {self.name} has left {count} running: {left[0]}" if left else ""

    def hurry(self) -> None:
        """The operator wants to stop: a call under way has little time left."""
        if self._inside:
            self._now_s = min(self._now_s, HURRY_S)
            signal.setitimer(signal.ITIMER_REAL, self._now_s / LOOKS, self._now_s / LOOKS)

    def _tick(self, number: int, frame: FrameType | None) -> None:
        if not self._inside:
            return
        if compiling.global_compiler_lock.is_locked():  # that is not the law's doing
            heartbeat().beat()
            return
        if (grown := self._with_this_call()) > self.memory_mb:
            raise LawStoppedError(self._too_much(grown))
        self._late += 1
        if self._late >= LOOKS:
            raise LawStoppedError(f"did not return within {self._now_s:g} s")

    def _resident_mb(self) -> float:
        return PAGE_MB * int(os.pread(self._statm, 64, 0).split()[1])

    def _with_this_call(self) -> float:
        """What the calls so far have added to the process [MB]."""
        return self._grown + self._resident_mb() - self._entered_mb

    def _too_much(self, grown: float) -> str:
        return (
            f"its calls have taken {grown:.0f} MB of memory, more than deploy.law_memory_mb ="
            f" {self.memory_mb:g}"
        )

    def forks(self) -> None:
        """Somebody calls os.fork()."""
        self._forked = self._forked or self._inside

    def end_of_a_fork(self) -> None:
        """In the new process: what a law has started must not fly on."""
        if self._inside:
            os._exit(1)


def _at_fork(tell: Callable[[LawWatch], None]) -> None:
    for watch in _open_watches:
        tell(watch)


os.register_at_fork(
    before=lambda: _at_fork(LawWatch.forks), after_in_child=lambda: _at_fork(LawWatch.end_of_a_fork)
)


def current() -> LawWatch | None:
    """The watch that is open in this process."""
    return _open_watches[-1] if _open_watches else None


@contextmanager
def reading(law: str) -> Iterator[None]:
    """A law's file is read and asked once meanwhile.

    Raises:
        UnusableLawError: it hangs, or does what a law must not.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    heart = heartbeat()
    before = heart.phase
    if before is Phase.STARTING:
        heart.phase = Phase.READING
    try:
        with LawWatch(law, READ_S, float("inf"), 0.0) as watch, watch.call(b""):
            yield
    except LawError as error:
        expected = "a law that can be read, and asked once, within half a minute"
        raise UnusableLawError("law", expected, str(error)) from None
    finally:
        heart.phase = before


@contextmanager
def patience() -> Iterator[None]:
    """Calls meanwhile may compile what they need."""
    watch = current()
    if watch is None:
        yield
        return
    with watch.allowing(max(FIRST_S, watch.limit_s)):
        yield


def hurry() -> None:
    """The operator wants to stop."""
    if (watch := current()) is not None:
        watch.hurry()


def left_running() -> str:
    """Words about threads that the law has left; empty: there are none."""
    watch = current()
    return "" if watch is None else watch.left_running()


class TimedLaw:
    """A law whose calls are watched."""

    def __init__(self, law: Law, watch: LawWatch, vehicle: str) -> None:
        self._law, self._watch, self._vehicle = law, watch, vehicle.encode()
        self.message_size = law.message_size
        self._took = array("d")  # each call of `propagate` [s]

    def concerns(self, law_state: Array) -> list[Concern]:
        """What the law says of the flight, and that it is too slow."""
        say = getattr(self._law, "concerns", None)
        found = [] if say is None else list(say(law_state))
        period = self._watch.period_s
        if len(self._took) < FEW:
            return found
        usual = max(map(statistics.median, (self._took, self._took[-FEW:])))
        if usual > period:
            text = (
                f"law {self._watch.name} takes {usual:.2g} s a call, {usual / period:.1f} times the"
                f" jet period of {period:g} s: on wires it would be late"
            )
            found.append(Concern("slow_law", text))
        return found

    def initial(self, own: Body, neighbours: Neighbours, world: World) -> Array:
        """See `Law`."""
        with self._watch.call(self._vehicle):
            return self._law.initial(own, neighbours, world)

    def rate(
        self, law_state: Array, own: Body, neighbours: Neighbours, world: World, t: float
    ) -> tuple[Array, Array]:
        """See `Law`."""
        with self._watch.call(self._vehicle):
            return self._law.rate(law_state, own, neighbours, world, t)

    def propagate(
        self, law_state: Array, own: Body, neighbours: Neighbours, world: World,
        t: float, duration: float, steps: int,
    ) -> Ahead:  # fmt: skip
        """See `Law`."""
        began = time.perf_counter()
        with self._watch.call(self._vehicle):
            ahead = self._law.propagate(
                law_state, own, neighbours, world, t, duration, steps
            )  # fmt: skip
        self._took.append(time.perf_counter() - began)
        return ahead


def timed(make: Callable[[], Law], vehicle: str) -> Law:
    """The law that `make` makes for a vehicle; watched where a watch is open."""
    watch = current()
    if watch is None:
        return make()
    with patience(), watch.call(vehicle.encode()):
        law = make()
    return TimedLaw(law, watch, vehicle)


def watching(
    controller: Any, limit_s: float, memory_mb: float, period_s: float
) -> AbstractContextManager[Any]:
    """The watch of a run; of none if its law is not a file of the user's own."""
    here = threading.current_thread() is threading.main_thread()
    if not isinstance(controller, OwnLawParams) or not here:
        return nullcontext()
    return LawWatch(controller.law, limit_s, memory_mb, period_s)
