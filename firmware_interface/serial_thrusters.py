"""`Thrusters` on a serial line: sends plans as frames and repeats them at 50 Hz until the next one.

A plan starts `command_delay_s` after it was issued, as the estimator assumes. A plan that is ready
earlier waits here, because the board starts plans on reception. A plan that is ready later is sent
with its age, and the board plays the rest of it.

The time to live of a plan is that of the command: if the sender hangs, the plan expires, its
repetition stops, and the board's watchdog closes all valves and latches SAFE.
"""

import threading
from collections import deque

from msgspec.structs import replace

from firmware_interface.frame import WRAP
from firmware_interface.messages import Config, ResetCause, Result, State, Status
from firmware_interface.serial_board import BAUD, SerialBoard, monotonic_us
from firmware_interface.session import Session, SessionError
from testbed.core.codes import FaultId, FaultReport
from testbed.core.error import TestbedError
from testbed.core.types import Health, ValveCommand
from testbed.core.vehicle import Gauges

KEEP_US = 4_000  # longest time between two checks for due frames
ANSWER_US = 3_000_000  # longest wait for a board's first answer
ALL_GAUGES = Gauges()
REPEAT_US = 30_000  # time after which a command without effect is repeated
REASON_US = 150_000  # longest wait for a reset board's HELLO_ACK, which has the cause
CAUSES = {
    ResetCause.UNKNOWN: "its chip does not say why",
    ResetCause.POWER_ON: "its power was off",
    ResetCause.BROWN_OUT: "its supply dipped (brown-out)",
    ResetCause.PIN: "by its reset pin: a button, a debugger",
    ResetCause.SOFTWARE: "by its own program",
    ResetCause.WATCHDOG: "by its watchdog: its program hung",
}


class ThrustersError(TestbedError):
    """The valves cannot be used."""


class SerialThrusters:
    """See `Thrusters`. Between `__enter__` and `__exit__` a thread maintains the session.

    Args:
        port: the board's device.
        config: limits, see `limits.limits_of`.
        delay_s: from issuing a plan to its start, `Vehicle.command_delay_s`.
        nonce: distinguishes this program from others.
        set_pressure: assumed supply pressure of a vehicle without a gauge [Pa].
        gauges: quantities that the board measures, from the vehicle file.
        epoch_us: the run's time 0 on the monotonic clock; set it before the first plan.

    Raises:
        ThrustersError, BoardError: no board, another board, or one built for another vehicle.
    """

    def __init__(
        self,
        port: str,
        config: Config,
        delay_s: float,
        nonce: int,
        baud: int = BAUD,
        set_pressure: float = 0.0,
        gauges: Gauges = ALL_GAUGES,
    ) -> None:
        self._port_name, self._delay_us = port, round(1e6 * delay_s)
        self._config, self._nonce, self._baud = config, nonce, baud
        self._set_pressure, self._gauges = set_pressure, gauges
        self.epoch_us = 0
        self.sent: deque[tuple[int, int]] = deque(maxlen=1000)  # plan numbers and times [us]
        self.trouble: FaultReport | None = None  # latched
        self._armed = False
        self._status_when_armed: Status | None = None
        self._reset_us: int | None = None  # when a reset of the board was noticed
        self._heard_us = 0  # time of the last frame from the board

    def __enter__(self) -> "SerialThrusters":
        self._board = SerialBoard(self._port_name, self._baud)
        self._session = Session(self._config, self._nonce)
        self._lock = threading.Condition()
        self._waiting: ValveCommand | None = None
        self._closing = False
        self._thread = threading.Thread(target=self._keep, name="valves", daemon=True)
        self._feed(self._session.hello(monotonic_us()))
        self._thread.start()
        try:
            self._await(lambda: self._session.greeted and self._session.status, "HELLO")
        except BaseException:
            self._end()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        self.disarm()
        end = monotonic_us() + REPEAT_US
        with self._lock:  # the frame must be written before the port is closed
            while self._session.state is State.ARMED and monotonic_us() < end:
                self._lock.wait(0.001)
        self._end()

    def _end(self) -> None:
        with self._lock:
            self._closing = True
            self._lock.notify_all()
        self._thread.join()
        self._board.close()

    # The session

    def _keep(self) -> None:
        with self._lock:
            while not self._closing:
                self._lock.wait(self._look(monotonic_us()) * 1e-6)

    def _look(self, now: int) -> int:
        """Do what is due; returns the time until the next action [us]."""
        try:
            if self._session.receive(self._board.read(), now):
                self._heard_us = now
        except SessionError as error:
            self.trouble = FaultReport(FaultId.BOARD_FAILED, str(error))
        self._judge(now)
        if self._waiting is not None:
            left = self._start_us(self._waiting) - now
            if left > 0:
                return min(left, KEEP_US)
            self._send(self._waiting)
        if data := self._session.due(now):
            self._feed(data)
        return KEEP_US

    def _judge(self, now: int) -> None:
        """Detect that the line was lost or an armed board has left ARMED."""
        session = self._session
        if self.trouble is not None:
            return
        if self._reset_us is not None:
            self._judge_reset(now, self._reset_us)
        elif not self._armed:
            return
        elif not self._board.connected:
            self.trouble = FaultReport(FaultId.LINE_LOST, "the serial line to the board is lost")
        elif session.state is not State.ARMED and session.status is not None:
            self._judge_left(session.status, now)

    def _judge_left(self, status: Status, now: int) -> None:
        """Say why an armed board is not armed any more; a board that was reset is asked."""
        if status.state is State.ARMED or status is self._status_when_armed:
            return  # the report with the reason follows the answer with the state
        if status.session == 0:  # as before the first HELLO
            self._armed, self._waiting, self._reset_us = False, None, now
            self._feed(self._session.hello(now))
            return
        own = self._session.board is not None and status.session == self._session.board.session
        why = ", ".join(f.name or "" for f in status.faults) or "no fault, it was disarmed"
        if not own:
            why = "another program has opened a session with it"
        self.trouble = FaultReport(
            FaultId.BOARD_LEFT_ARMED, f"the board has left ARMED: {why.lower()}"
        )

    def _judge_reset(self, now: int, since: int) -> None:
        """Report a reset with its cause, or without if the board does not say it soon."""
        board = self._session.board
        if self._session.greeted and board is not None:
            why = CAUSES[board.reset_cause]
        elif now - since > REASON_US:
            why = "it does not answer why"
        else:
            return
        self.trouble = FaultReport(FaultId.BOARD_RESET, f"the board was reset: {why}")

    def _feed(self, data: bytes) -> None:
        if data:
            self._board.feed(data)

    def _await(self, done: object, what: str) -> None:
        assert callable(done)
        end = monotonic_us() + ANSWER_US
        with self._lock:
            while not done():
                if self.trouble is not None:
                    raise ThrustersError(self.trouble.text)
                if monotonic_us() > end:
                    raise ThrustersError(
                        f"{self._port_name}: the board does not answer {what}; check its power, the"
                        " cable, and that this is its port"
                    )
                self._lock.wait(0.005)

    # Interface of the vehicle

    @property
    def board(self) -> str:
        """Description of the board that drives the valves."""
        hello = self._session.board
        assert hello is not None
        return f"firmware {hello.firmware_id:08x} at {self._port_name}"

    @property
    def reconnects(self) -> int:
        """Number of times the line was lost and restored."""
        return self._board.reconnects

    @property
    def refusals(self) -> dict[str, int]:
        """Number of frames that the board refused, by result."""
        return {result.name.lower(): count for result, count in self._session.refusals.items()}

    def bearing(self, *, on: bool) -> None:
        """Switch bearing air on or off.

        Raises:
            ThrustersError: the board does not confirm it.
        """
        self._insist(
            lambda now: self._session.bearing(on, now),
            lambda: self._session.status is not None and self._session.status.bearing == int(on),
            "BEARING",
        )

    @property
    def floats(self) -> bool:
        """Whether bearing air is on, from the board's newest report."""
        status = self._session.status
        return status is not None and status.bearing == 1

    def arm(self) -> None:
        """Arm; plans must follow at once.

        Raises:
            ThrustersError: the board refuses, or does not answer.
        """
        self._insist(self._session.arm, lambda: self._session.state is State.ARMED, "ARM")
        self._status_when_armed = self._session.status
        self._armed = True

    def _insist(self, order: object, done: object, what: str) -> None:
        assert callable(order)
        assert callable(done)
        sent = 0

        def obeyed() -> bool:
            nonlocal sent
            if not done() and monotonic_us() - sent > REPEAT_US:
                sent = monotonic_us()
                self._feed(self._greet_again(sent) or order(sent))
            return bool(done())

        self._await(obeyed, what)

    def _greet_again(self, now: int) -> bytes:
        """A new HELLO if the board uses another session, after two HELLO in a row."""
        foreign = self._session.refusals.pop(Result.FOREIGN_SESSION, 0)
        if foreign == 0 and self._session.greeted:
            return b""
        return self._session.hello(now) if foreign else b"\0"

    def disarm(self) -> None:
        """Close all valves now and leave ARMED."""
        with self._lock:
            self._armed, self._waiting = False, None
            self._feed(self._session.disarm(monotonic_us()))

    def land(self) -> None:
        """Close all valves and shut off bearing air; can be called repeatedly."""
        self.disarm()
        with self._lock:
            if self._session.greeted:
                self._feed(self._session.bearing(False, monotonic_us()))

    def _start_us(self, command: ValveCommand) -> int:
        return self.epoch_us + round(1e6 * command.issued_at) + self._delay_us

    def apply(self, command: ValveCommand) -> None:
        """See `Thrusters`."""
        with self._lock:
            self._waiting = command
            if self._start_us(command) <= monotonic_us():
                self._send(command)
            else:
                self._lock.notify_all()

    def _send(self, command: ValveCommand) -> None:
        self._waiting = None
        if not self._armed:
            return
        shift = 1e-6 * (self.epoch_us + self._delay_us)
        moved = replace(
            command,
            issued_at=command.issued_at + shift,
            valid_until=command.valid_until + shift,
        )
        now = monotonic_us()
        self._feed(self._session.apply(moved, now))
        self.sent.append((command.seq, now))

    def health(self) -> Health:
        """See `Thrusters`. The board has no gauge at the tank."""
        with self._lock:
            status = self._session.status
            assert status is not None
            now = monotonic_us()
            pressure = float(status.supply_pa) if self._gauges.supply else self._set_pressure
            gauges = self._gauges
            battery = 1e-3 * status.supply_mv if gauges.battery else gauges.battery_v
            silent = 1e-6 * (now - self._heard_us)
            return Health(1e-6 * (now - self.epoch_us), pressure, 0.0, battery, silent)

    def edges(self) -> list[tuple[float, int]]:
        """Valve edges reported since the last call: time of the run [s], mask."""
        with self._lock:
            new, self._session.edges = self._session.edges, []
            clock, now = self._session.clock, monotonic_us()
        if clock is None:
            return []
        found = []
        for board_us, mask in new:
            ago = (now + clock.offset_us - board_us) % WRAP
            if ago > WRAP / 2:  # the board's clock is known to some microseconds
                ago -= WRAP
            found.append((1e-6 * (now - ago - self.epoch_us), mask))
        return found

    @property
    def shut(self) -> bool:
        """Whether every valve is closed, from the board's newest report."""
        status = self._session.status
        return status is not None and status.mask == 0
