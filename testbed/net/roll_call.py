"""The roll call: a waiting vehicle and its host agree on who may order it to start.

The vehicle draws a number, its ticket, and gives it to the host. An order to start without the
ticket is refused, from any sender. The ticket is sent again every second, because a host that
was restarted does not know it. A vehicle that ends before its flight, by an error or by a
stop, sends the reason.
"""

import secrets
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from functools import partial
from typing import Any

import msgspec
import zenoh
from msgspec import Struct

from testbed.net.keys import Keys
from testbed.net.session import NetworkError, answer_to, ask
from testbed.realtime.wall_clock import monotonic_ns

AGAIN_NS = 1_000_000_000  # between two enrolments
LEAVE_S = 0.5  # time for the host to receive the reason
LONGEST = 500  # longest reason [characters]


class Enrol(Struct, frozen=True, tag=True):
    """A vehicle is ready to take an order."""

    ticket: int  # an order to start must contain it


class Leave(Struct, frozen=True, tag=True):
    """A vehicle has ended before its flight."""

    reason: str
    by_operator: bool = False  # by a stop, which the host may not have heard


_decode = msgspec.msgpack.Decoder(Enrol | Leave).decode


class Roll:
    """The host's list of vehicles. Keep the object as long as vehicles may enrol."""

    def __init__(self, session: zenoh.Session, keys: Keys, names: Iterable[str]) -> None:
        self.tickets: dict[str, int] = {}  # by vehicle
        self.left: dict[str, str] = {}  # vehicles that have left, and why
        self.stopped = False  # an operator's stop has reached a vehicle
        self._kept = [
            answer_to(session, keys.of(name, "roll"), partial(self._answer, name)) for name in names
        ]

    def farewells(self) -> dict[str, str]:
        """Vehicles that have left since the last call, and why."""
        left, self.left = self.left, {}
        return left

    def _answer(self, name: str, data: bytes) -> bytes:
        match _decode(data):
            case Enrol(ticket):
                self.tickets[name] = ticket
                self.left.pop(name, None)
            case Leave(reason, by_operator):
                self.stopped = self.stopped or by_operator
                self.tickets.pop(name, None)
                self.left[name] = reason[:LONGEST]
        return b"heard"


class Enrolment:
    """The vehicle's side of the roll call.

    Raises:
        NetworkError: the host does not answer.
    """

    def __init__(self, session: zenoh.Session, keys: Keys, name: str) -> None:
        self.ticket = secrets.randbits(63)
        self._session, self._key = session, keys.of(name, "roll")
        self._data = msgspec.msgpack.encode(Enrol(self.ticket))
        ask(session, self._key, self._data)
        self._due = monotonic_ns() + AGAIN_NS

    def look(self) -> None:
        """Enrol again if it is due; does not wait for the answer."""
        now = monotonic_ns()
        if now < self._due:
            return
        self._due = now + AGAIN_NS

        def unheard(_: Any) -> None:
            """Ignore the answer: the vehicle enrols again anyway."""

        answers = zenoh.handlers.Callback(unheard, indirect=False)
        self._session.get(self._key, answers, payload=self._data, timeout=1.0)


@contextmanager
def last_words(session: zenoh.Session, keys: Keys, name: str) -> Iterator[None]:
    """Send the host the reason if this vehicle ends by an error."""
    try:
        yield
    except BaseException as error:
        farewell(session, keys, name, str(error) or "interrupted")
        raise


def farewell(
    session: zenoh.Session, keys: Keys, name: str, reason: str, *, by_operator: bool = False
) -> None:
    """Tell the host why this vehicle ends before its flight."""
    with suppress(NetworkError):
        words = msgspec.msgpack.encode(Leave(reason[:LONGEST], by_operator))
        ask(session, keys.of(name, "roll"), words, LEAVE_S)
