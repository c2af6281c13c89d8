"""The page's STOP: the same stop as `testbed stop`, by every way that leads to the vehicles.

A flight on the twin gets a signal. On wires the stop goes to each vehicle directly and through the
host, with one id, so it counts once. The connection to the host is kept open before the button is
pressed. A host that hangs or is suspended does not keep a stop from its vehicles.
"""

import os
import secrets
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from contextlib import contextmanager, suppress
from pathlib import Path
from threading import Event, Lock, Thread
from typing import Any, NamedTuple

import zenoh

from testbed.net.direct_stop import stop_directly
from testbed.net.flight_note import StoppableFlight, known_flights, runs
from testbed.net.keys import Keys
from testbed.net.session import NetworkError, answers, dial
from testbed.net.stop import ANSWER_S, answer_of, end_twin, ended_vehicles
from testbed.realtime.wall_clock import monotonic_ns

LOOK_S = 0.5  # between two looks at the connections
OPEN_S = 1.0  # time for a host's handshake
PRIORITY = 90  # of a press, above hosts and vehicles


class StopRoute(NamedTuple):
    """StopRoute by which the flight can be stopped now."""

    words: str
    ready: bool


NONE = StopRoute("not connected: this run does not fly on this machine", ready=False)
TWIN = StopRoute("STOP ends the twin's process", ready=True)
HOST = StopRoute("STOP goes to the vehicles and to the host", ready=True)
DIRECT = StopRoute("the host does not answer; STOP goes to the vehicles directly", ready=True)


class StopSender:
    """Keeps the connections to one run's flight.

    Args:
        run: its folder.
    """

    def __init__(self, run: Path) -> None:
        self._run, self._lock = str(run.absolute()), Lock()
        self._note: tuple[Path, StoppableFlight] | None = None
        self._host: zenoh.Session | None = None
        self.ways = NONE
        self._answered: dict[str, Future[dict[str, Any]]] = {}  # by press

    @property
    def note(self) -> Path | None:
        """The flight's note; None: there is none."""
        return None if self._note is None else self._note[0]

    # Connections

    def keep(self, left: Event) -> None:
        """Find the flight and keep its connection, until `left` is set."""
        while not left.is_set():
            found = next((one for one in known_flights() if one[1].folder == self._run), None)
            if found is not None and not found[1].endpoint and not runs(found[1]):
                found = None
            self._note = found  # that of a killed host stays while its vehicles fly
            if self._note is None:
                self._hang_up()
                self.ways = NONE
            elif self._note[1].endpoint:
                self.ways = HOST if self._reaches_host(self._note[1]) else DIRECT
            else:
                self.ways = TWIN
            left.wait(LOOK_S)
        self._hang_up()

    def _reaches_host(self, flight: StoppableFlight) -> bool:
        if self._host is None:
            with suppress(NetworkError):
                self._host = dial(flight.endpoint, 0.0, _keys(flight), OPEN_S)
                if flight.keys:
                    import testbed.net.signature  # noqa: F401  (slow; not at the press)
        return self._host is not None and bool(list(self._host.info.routers_zid()))

    def _hang_up(self) -> None:
        host, self._host = self._host, None
        if host is not None:
            with suppress(zenoh.ZError):
                host.close()

    # A press

    def press(self, number: str) -> dict[str, Any]:
        """Stop; a repeated `number` is the same press and stops nothing twice."""
        heard_ns = monotonic_ns()
        with self._lock:
            known, mine = self._answered.get(number), Future[dict[str, Any]]()
            self._answered.setdefault(number, mine)
        if known is not None:
            return known.result()
        with ahead():
            try:
                mine.set_result({**self._stop(), "heard_ns": heard_ns})
            except Exception as error:  # the button says so, and may be pressed again
                mine.set_result({"lines": [f"not stopped: {error}"], "sent": False})
        return mine.result()

    def _stop(self) -> dict[str, Any]:
        if self._note is None:
            return {"lines": [self.ways.words], "sent": False}
        note, flight = self._note
        if flight.endpoint:
            return self._stop_wires(flight)
        try:
            end_twin(note, flight)
        except OSError as error:
            return {"lines": [f"{flight.name}: not asked: {error}"], "sent": False}
        return {"lines": [f"{flight.name} on the {flight.rig}: stops"], "sent": True}

    def _stop_wires(self, flight: StoppableFlight) -> dict[str, Any]:
        answered, stop, ended = set[str](), secrets.token_hex(8), dict[str, str]()
        expected = set(flight.vehicles)

        def directly() -> None:
            answered.update(
                stop_directly(
                    flight.endpoint, flight.lab, _keys(flight), expected, stop, ANSWER_S
                )
            )  # fmt: skip

        def over_host() -> None:
            if self._host is not None:
                keys = Keys(flight.lab)
                self._host.put(keys.stop, stop.encode())
                replies = answers(self._host, keys.stop, ANSWER_S, stop.encode())
                answered.update(one.decode(errors="replace") for one in replies)
                ended.update(ended_vehicles(self._host, keys))

        both = [Thread(target=_quietly, args=(one,), daemon=True) for one in (directly, over_host)]
        for one in both:
            one.start()
        for one in both:
            if not (expected and answered >= expected):
                one.join(2.0 * ANSWER_S)
        names = sorted({*expected, *answered, *ended})
        lines = [f"{name}: {answer_of(name, answered, ended)}" for name in names]
        return {"lines": lines or ["no vehicle answered"], "sent": bool(answered or ended)}


def _keys(flight: StoppableFlight) -> Path | None:
    return Path(flight.keys) if flight.keys else None


def _quietly(stop: Callable[[], None]) -> None:
    """Try one way; a failure does not stop the other."""
    with suppress(zenoh.ZError, OSError):
        stop()


@contextmanager
def ahead() -> Iterator[None]:
    """Run this thread and those it starts before flights, where the system allows it."""
    policy, own = os.sched_getscheduler(0), os.sched_getparam(0)
    with suppress(OSError):
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))
    try:
        yield
    finally:
        with suppress(OSError):
            os.sched_setscheduler(0, policy, own)
