"""Orders to a vehicle: look, start, stop, fly on with other gains."""

import threading
from collections.abc import Callable
from queue import SimpleQueue

import msgspec
import zenoh

from testbed.net.commands import Accepted, Answer, Look, Order, Refused, Retune, Start, Stop
from testbed.net.keys import Keys
from testbed.net.session import answer_to, on_message
from testbed.realtime.wall_clock import monotonic_ns
from testbed.rig.wired.preflight_monitor import PreflightMonitor
from testbed.rig.wired.stop_requests import StopRequests

SOONEST_NS = 1_000_000_000  # an order to start may be late by this much
FARTHEST_NS = 30_000_000_000  # an order to start may be early by this much
OBEYED_S = 0.5  # if the loop has not obeyed a stop by then it hangs: shut without it


class CommandServer:
    """Receives and answers orders to a vehicle."""

    def __init__(
        self, session: zenoh.Session, keys: Keys, name: str, board: str,
        preflight: PreflightMonitor, ticket: int,
        to_own: Callable[[int], int | None] = lambda host_ns: None,
    ) -> None:  # fmt: skip
        """Start to receive orders.

        Args:
            session: the network.
            keys: of the lab.
            name: of the vehicle.
            board: name of the board that drives the valves.
            preflight: reports the vehicle's readiness.
            ticket: an order to start must contain it.
            to_own: converts a time of the host's clock to this machine's clock.
        """
        self._preflight, self._ticket, self._to_own = preflight, ticket, to_own
        self.refused_orders = 0  # orders that could not be decoded
        self.starts: SimpleQueue[Start] = SimpleQueue()
        self.stop_reason: str | None = None
        self._name, self._board, self._flying = name, board, threading.Event()
        self._close: Callable[[], None] | None = None
        self.stops = StopRequests()
        self.operator_stops = 0  # without those that the host ordered
        self._obeyed = threading.Event()
        # of the law on board: why it does not change, empty if it does
        self.retune: Callable[[Retune], str] = lambda order: (
            "its law is not on board, or not flying"
        )
        self._kept = [
            answer_to(session, keys.of(name, "order"), self._order),
            answer_to(session, keys.stop, self.operator_stop),
            on_message(session, keys.stop, self.operator_stop),
        ]

    def take_off(self, close: Callable[[], None]) -> None:
        """Let a repeated or ignored stop call `close` in another thread from now on."""
        self._close = close

    def obey(self) -> None:
        """The flight's loop has received the stop and brakes."""
        self._obeyed.set()

    def _order(self, data: bytes) -> bytes:
        try:
            order: Order = msgspec.msgpack.decode(data, type=Order)
        except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError):
            self.refused_orders += 1
            raise
        answer: Answer
        match order:
            case Look():
                answer = self._preflight.ready()
            case Stop(reason, at_once):
                if at_once:
                    self.stops.insist()
                self._stop(reason)
                answer = Accepted(self._board)
            case Retune():
                why = self.retune(order)
                answer = Refused(why) if why else Accepted(self._board)
            case Start():
                begin = self._to_own(order.epoch_ns)
                ahead = 0 if begin is None else begin - monotonic_ns()
                if order.ticket != self._ticket:
                    self.refused_orders += 1
                    answer = Refused("the order to start is not from the host of this session")
                elif self._flying.is_set():
                    answer = Refused("it already flies")
                elif not -SOONEST_NS <= ahead <= FARTHEST_NS:
                    self.refused_orders += 1
                    answer = Refused(f"start time is in {1e-9 * ahead:.1f} s; expected 0 to 30 s")
                else:
                    self._flying.set()
                    self.starts.put(order)
                    answer = Accepted(self._board)
        return msgspec.msgpack.encode(answer)

    def operator_stop(self, stop: bytes) -> bytes:
        """Obey an operator's stop and answer it; `stop` is its id."""
        self.operator_stops = self.stops.count(stop)
        self._stop("stopped by the operator")
        return self._name.encode()  # the vehicle that stops

    def _stop(self, reason: str) -> None:
        first = self.stop_reason is None
        if first:
            self.stop_reason = reason
        if self._close is None:
            return
        if self.stops.times > 1:
            self._close()
        elif first:
            insist = threading.Timer(OBEYED_S, self._insist)
            insist.daemon = True
            insist.start()

    def _insist(self) -> None:
        if self._close is not None and not self._obeyed.is_set():
            self._close()
