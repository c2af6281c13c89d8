"""The vehicle's ear for what it is told to do: look, start, stop."""

import threading
from collections.abc import Callable
from queue import SimpleQueue

import msgspec
import zenoh

from testbed.net.commands import Accepted, Answer, Look, Order, Refused, Start, Stop
from testbed.net.keys import Keys
from testbed.net.session import answer_to, on_word
from testbed.realtime.wall_clock import monotonic_ns
from testbed.rig.wired.preflight_monitor import PreflightMonitor

SOONEST_NS = 1_000_000_000  # an order to start may be late by so much
FARTHEST_NS = 30_000_000_000  # and early


class CommandServer:
    """The vehicle's ear for what it is told to do."""

    def __init__(
        self, session: zenoh.Session, keys: Keys, name: str, board: str, lookout: PreflightMonitor,
        to_own: Callable[[int], int | None] = lambda host_ns: None,
    ) -> None:  # fmt: skip
        """Listen; `to_own` says when a time of the host's clock is on this machine's."""
        self._lookout, self._to_own = lookout, to_own
        self.bad_orders = 0  # that were none
        self.starts: SimpleQueue[Start] = SimpleQueue()
        self.stop_reason: str | None = None
        self._name, self._board, self._flying = name, board, threading.Event()
        self._close: Callable[[], None] | None = None
        self._kept = [
            answer_to(session, keys.of(name, "order"), self._order),
            answer_to(session, keys.stop, lambda _: self._stop("stopped by the operator")),
            on_word(session, keys.stop, lambda: self._stop("stopped by the operator")),
        ]

    def take_off(self, close: Callable[[], None]) -> None:
        """From now on a stop calls `close` at once."""
        self._close = close

    def _order(self, data: bytes) -> bytes:
        try:
            order: Order = msgspec.msgpack.decode(data, type=Order)
        except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError):
            self.bad_orders += 1
            raise
        answer: Answer
        match order:
            case Look():
                answer = self._lookout.ready()
            case Stop(reason):
                self._stop(reason)
                answer = Accepted(self._board)
            case Start():
                begin = self._to_own(order.epoch_ns)
                ahead = 0 if begin is None else begin - monotonic_ns()
                if self._flying.is_set():
                    answer = Refused("it flies already")
                elif not -SOONEST_NS <= ahead <= FARTHEST_NS:
                    self.bad_orders += 1
                    answer = Refused(f"to start in {1e-9 * ahead:.1f} s; expected 0 to 30 s")
                else:
                    self._flying.set()
                    self.starts.put(order)
                    answer = Accepted(self._board)
        return msgspec.msgpack.encode(answer)

    def _stop(self, reason: str) -> bytes:
        if self.stop_reason is None:
            self.stop_reason = reason
        if self._close is not None:
            self._close()
        return self._name.encode()  # who has shut its valves
