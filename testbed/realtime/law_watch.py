"""Time and memory limits for calls of a user's law: in Python, or a policy in an ONNX file.

An alarm interrupts a call that exceeds its limit and raises an error inside the law, so that the
run ends in order, as after any other error of a law: see `law_alarm.py`. If the law ignores the
error (it is in compiled code, or catches everything), the supervisor process kills its process:
see `cli/process_supervisor.py`.

Each thread that flies has a watch of its own. Memory and threads are those of the whole process, so
only the watch of the main thread limits them.
"""

import math
import os
import statistics
import sys
import threading
import time
from array import array
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager, nullcontext
from functools import cache
from pathlib import Path
from typing import Any

import numba.core.compiler_lock as compiling

from controllers.catalogue import UsersLaw
from controllers.law_file import LawError, LawStoppedError, UnusableLawError, file_of
from controllers.onnx_policy import OnnxParams
from testbed.core.codes import FaultId, FaultReport
from testbed.core.law import Ahead, Array, Body, Concern, Law, Neighbours, World, concerns_of
from testbed.realtime.heartbeat import Heartbeat, RunPhase, heartbeat
from testbed.realtime.law_alarm import Alarm, make_alarm

READ_S = 30.0  # limit for reading a law's file: it may import large packages
FIRST_S = 10.0  # limit for the first calls, before the flight, without numba's compilation
HURRY_S = 0.5  # limit for a call that continues after the operator's stop
LOOKS = 4  # timer ticks before the limit: a suspended process is not a hanging law
STARTS = ("subprocess.Popen", "os.posix_spawn", "os.system", "os.exec")  # audit events
WAITS = Path("/proc/thread-self/schedstat")  # second number: waits for a free core [ns]
PAGE_MB = os.sysconf("SC_PAGE_SIZE") / 1e6
FEW = 3  # calls needed to warn of a slow law; on wires a flight ends after this many slow ones
MANY = 10  # calls needed to call it a fault
FAR = 2.0  # a median call that takes this many times its budget is a fault


class _Open(threading.local):
    """The open watches of this thread; the last one is in effect."""

    def __init__(self) -> None:
        self.watches: list[LawWatch] = []


_open = _Open()


class LawWatch:
    """A context manager that watches the calls of all laws in one thread.

    Args:
        law: its name in the experiment, "my_law.py:Mine", or of a policy's file.
        limit_s: for one call [s].
        memory_mb: limit of memory that all calls together add to the process [MB].
        budget_s: time that a call has on the bench and on the table [s].
    """

    def __init__(self, law: str, limit_s: float, memory_mb: float, budget_s: float) -> None:
        path = file_of(law)
        self.name = law if path is None else path.name
        self._alone = threading.current_thread() is threading.main_thread()
        self.memory_mb = memory_mb if self._alone else math.inf
        self.limit_s, self.budget_s = limit_s, budget_s
        self.laws: list[TimedLaw] = []
        self._now_s = limit_s  # the current limit
        self._inside = False
        self._late, self._grown, self._entered_mb = 0, 0.0, 0.0
        self._forked = False
        self._stack = ExitStack()

    def __enter__(self) -> "LawWatch":
        _listen()
        self._threads = set(threading.enumerate())
        self._alarm: Alarm = make_alarm(self._tick)
        self._stack.callback(self._alarm.close)
        self._statm = self._open("/proc/self/statm")
        self._waits = self._open(str(WAITS)) if WAITS.exists() else None
        # the supervisor looks at the main thread only
        self._heart = heartbeat() if self._alone else Heartbeat()
        self._heart.law, self._heart.limits = self.name, (self.limit_s, self.memory_mb)
        _open.watches.append(self)
        self._stack.callback(_open.watches.remove, self)
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()

    @contextmanager
    def allowing(self, limit_s: float) -> Iterator[None]:
        """While open, use another limit for a call [s]."""
        before, self._now_s = self._now_s, limit_s
        try:
            yield
        finally:
            self._now_s = before

    @contextmanager
    def call(self, vehicle: bytes) -> Iterator[None]:
        """While open, a call of the law is watched.

        Raises:
            LawError: it took too much time or memory.
        """
        self._entered_mb = self._resident_mb()
        self._late, self._forked = 0, False
        self._heart.enter(vehicle)
        self._inside = True
        self._alarm.set(self._now_s / LOOKS)
        try:
            try:
                yield
            finally:
                self._leave()
        except LawStoppedError as error:  # raised in this module, not in the law
            self._leave()
            raise LawError(f"{self.name}: {error}") from None
        self._grown = self._with_this_call()
        if self._forked:
            raise LawError(f"{self.name}: started a process by os.fork(); a law must not")
        if self._grown > self.memory_mb:
            raise LawError(f"{self.name}: {self._too_much(self._grown)}")

    def _leave(self) -> None:
        self._inside = False
        self._alarm.set(0.0)
        self._heart.leave()

    def complaint(self) -> FaultReport | None:
        """Fault of the law that shows at the end of the flight.

        It has left threads that would keep the process alive, or is far too slow to fly on wires.
        """
        left = [
            one.name for one in threading.enumerate()
            if self._alone and one not in self._threads and not one.daemon
        ]  # fmt: skip
        if left:
            count = "a thread" if len(left) == 1 else f"{len(left)} threads"
            text = f"law {self.name} has left {count} running: {left[0]}"
            return FaultReport(FaultId.LAW_STUCK, text)
        usual = max((one.median() for one in self.laws if len(one.took) >= MANY), default=0.0)
        slow = usual > FAR * self.budget_s
        return FaultReport(FaultId.LAW_SLOW, self.slow(usual)) if slow else None

    def slow(self, usual: float) -> str:
        """Text about a law whose median call takes this long [s]."""
        return (
            f"law {self.name} takes {usual:.2g} s per call, {usual / self.budget_s:.1f} times the"
            f" {self.budget_s:.2g} s that it has on the bench and on the table"
        )

    def clock(self) -> float:
        """Time without this thread's waits for a free core: they are not the law's [s]."""
        if self._waits is None:
            return time.perf_counter()
        return time.perf_counter() - 1e-9 * int(os.pread(self._waits, 64, 0).split()[1])

    def shorten_limit(self) -> None:
        """The operator stopped the run: shorten the limit of the active call."""
        if self._inside:
            self._now_s = min(self._now_s, HURRY_S)
            self._alarm.set(self._now_s / LOOKS)

    def _tick(self) -> None:
        if not self._inside:
            return
        if compiling.global_compiler_lock.is_locked():  # numba compiles
            self._heart.beat()
            return
        if (grown := self._with_this_call()) > self.memory_mb:
            raise LawStoppedError(self._too_much(grown))
        self._late += 1
        if self._late >= LOOKS:
            raise LawStoppedError(f"did not return within {self._now_s:g} s")

    def _open(self, path: str) -> int:
        file = os.open(path, os.O_RDONLY)
        self._stack.callback(os.close, file)
        return file

    def _resident_mb(self) -> float:
        return PAGE_MB * int(os.pread(self._statm, 64, 0).split()[1])

    def _with_this_call(self) -> float:
        """Memory added to the process by all calls so far [MB]."""
        return self._grown + self._resident_mb() - self._entered_mb

    def _too_much(self, grown: float) -> str:
        return (
            f"its calls have taken {grown:.0f} MB of memory, more than deploy.law_memory_mb ="
            f" {self.memory_mb:g}"
        )

    def forks(self) -> None:
        """Called before os.fork()."""
        self._forked = self._forked or self._inside

    def starts(self, event: str) -> None:
        """Called before a process is started; a file may do so while it is read or compiled.

        Raises:
            LawStoppedError: a law starts it, in flight.
        """
        in_flight = self._inside and self._now_s <= self.limit_s and self.budget_s > 0.0
        if in_flight:
            raise LawStoppedError(f"started a process by {event}; a law must not")

    def end_of_a_fork(self) -> None:
        """Called in the new process: a process started by a law must not continue the flight."""
        if self._inside:
            os._exit(1)


def _at_fork(call: Callable[[LawWatch], None]) -> None:
    for watch in _open.watches:
        call(watch)


os.register_at_fork(
    before=lambda: _at_fork(LawWatch.forks), after_in_child=lambda: _at_fork(LawWatch.end_of_a_fork)
)


@cache
def _listen() -> None:
    """Hear of every process that is started; this cannot be undone."""

    def audit(event: str, arguments: tuple[object, ...]) -> None:
        if event in STARTS:
            for watch in _open.watches:
                watch.starts(event)

    sys.addaudithook(audit)


def current() -> LawWatch | None:
    """The open watch of this thread; None: no watch is open."""
    return _open.watches[-1] if _open.watches else None


@contextmanager
def reading(law: str, key: str = "law") -> Iterator[None]:
    """While open, a law's file, which this key of [controller] names, is read and called.

    Raises:
        UnusableLawError: it hangs, or does what a law must not.
    """
    here = threading.current_thread() is threading.main_thread()
    heart = heartbeat() if here else Heartbeat()
    before = heart.phase
    if before is RunPhase.STARTING:
        heart.phase = RunPhase.READING
    try:
        with LawWatch(law, READ_S, float("inf"), 0.0) as watch, watch.call(b""):
            yield
    except LawError as error:
        expected = "a law that can be read and called once within half a minute"
        raise UnusableLawError(key, expected, str(error)) from None
    finally:
        heart.phase = before


@contextmanager
def patience() -> Iterator[None]:
    """While open, calls have more time, because they may compile."""
    watch = current()
    if watch is None:
        yield
        return
    with watch.allowing(max(FIRST_S, watch.limit_s)):
        yield


def shorten_limit() -> None:
    """Shorten the limit of the active call after the operator's stop."""
    if (watch := current()) is not None:
        watch.shorten_limit()


def complaint() -> FaultReport | None:
    """Fault of the law that shows at the end of the flight."""
    watch = current()
    return None if watch is None else watch.complaint()


class TimedLaw:
    """A law with watched calls."""

    def __init__(self, law: Law, watch: LawWatch, vehicle: str) -> None:
        self._law, self._watch, self._vehicle = law, watch, vehicle.encode()
        self.message_size = law.message_size
        self.took = array("d")  # duration of each call of `propagate` [s]
        watch.laws.append(self)

    def median(self, last: int = 0) -> float:
        """Median duration of the last calls, or of all [s]."""
        return statistics.median(self.took[-last:])

    def concerns(self, law_state: Array) -> list[Concern]:
        """The law's concerns, and one more if it is too slow."""
        found = concerns_of(self._law, law_state)
        if len(self.took) < FEW:
            return found
        usual = max(self.median(), self.median(FEW))
        if usual > self._watch.budget_s:
            found.append(Concern("slow_law", self._watch.slow(usual)))
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
        began = self._watch.clock()
        with self._watch.call(self._vehicle):
            ahead = self._law.propagate(
                law_state, own, neighbours, world, t, duration, steps
            )  # fmt: skip
        self.took.append(self._watch.clock() - began)
        return ahead


def timed(make: Callable[[], Law], vehicle: str) -> Law:
    """Make a law for a vehicle; its calls are watched if a watch is open."""
    watch = current()
    if watch is None:
        return make()
    with patience(), watch.call(vehicle.encode()):
        law = make()
    return TimedLaw(law, watch, vehicle)


def watching(
    controller: Any, limit_s: float, memory_mb: float, budget_s: float
) -> AbstractContextManager[Any]:
    """The watch of a run; does nothing if its law is not in a user's file."""
    if not isinstance(controller, UsersLaw):
        return nullcontext()
    law = Path(controller.file).name if isinstance(controller, OnnxParams) else controller.law
    return LawWatch(law, limit_s, memory_mb, budget_s)
