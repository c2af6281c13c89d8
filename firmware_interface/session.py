"""The host's side of a session with the board: HELLO, arming, sending and repeating plans.

A pure state machine: its inputs are times and bytes, its output bytes; the caller does the I/O.
Times are the host's clock in integer microseconds.

Clock offset and delay as in NTP: D. L. Mills, "Internet time synchronization: the network time
protocol", IEEE Transactions on Communications 39(10), 1991. T1 sent by the host, T2 received and T3
answered by the board, T4 received by the host:

    offset = ((T2 - T1) + (T3 - T4)) / 2        board's clock minus host's
    delay  = (T4 - T1) - (T3 - T2)              on the line, both ways

A pulse that lasts to the end of its plan may continue in the next plan, but plans never arrive
exactly on time. Sent unchanged, the board would close the valve for its minimum off-time whenever
the next plan arrives a microsecond late. The board cannot know the next plan and must not guess, so
the sender extends such a pulse by `CARRY_US`. The next plan ends or continues it on arrival; the
board's limits hold.
"""

import struct
from collections import deque
from typing import NamedTuple

from firmware_interface.frame import WRAP, Decoder, Frame, encode_message
from firmware_interface.limits import config_hash
from firmware_interface.messages import (
    VALVES,
    VERSION,
    Ack,
    Arm,
    Bearing,
    Cmd,
    Config,
    Disarm,
    Edges,
    Hello,
    HelloAck,
    Message,
    Ping,
    Result,
    State,
    Status,
)
from testbed.core.error import TestbedError
from testbed.core.types import ValveCommand

REFRESH_US = 20_000  # 50 Hz: six frames in a row may be lost before the watchdog trips
HELLO_RETRY_US = 100_000
CARRY_US = 2 * REFRESH_US  # one frame lost, and as much again for a host that wakes late [assumed]
EDGES_KEPT = 4096  # if not taken, the oldest are dropped
EXCHANGES = 16  # clock exchanges remembered; the one with the shortest delay counts


class SessionError(TestbedError):
    """This board must not be armed by this program."""


class Exchange(NamedTuple):
    """One reading of the board's clock."""

    offset_us: float  # board's clock minus host's, modulo the wrap, in [0, WRAP)
    delay_us: int  # on the line, both ways


def exchange(t1_us: int, t2_us: int, t3_us: int, t4_us: int) -> Exchange:
    """Offset and delay from four timestamps, all of which wrap."""
    there = (t2_us - t1_us) % WRAP
    back = (t3_us - t4_us) % WRAP
    apart = (back - there + WRAP // 2) % WRAP - WRAP // 2  # is minus the delay
    return Exchange((there + apart / 2) % WRAP, -apart)


def carried(plan: Cmd, carry_us: int, config: Config) -> Cmd:
    """The plan with pulses that last to its end, and so its time to live, extended."""
    last = plan.ttl_us - 1  # times in seconds are rounded to the nearest microsecond
    pulses = tuple(zip(plan.on_us, plan.offset_us, strict=True))
    lasting = [on > 0 and offset + on >= last for on, offset in pulses]
    if not any(lasting):
        return plan
    ttl_us = max(plan.ttl_us, min(plan.ttl_us + carry_us, config.max_ttl_us))
    on_us = tuple(
        max(on, min(ttl_us - offset, config.max_on_us)) if lasts else on
        for (on, offset), lasts in zip(pulses, lasting, strict=True)
    )
    return Cmd(plan.session, plan.plan, plan.age_us, ttl_us, on_us, plan.offset_us)


class Session:
    """The session of one host with one board.

    Args:
        config: the limits that the board must have been built with.
        nonce: distinguishes this program's HELLO from others'.
        carry_us: see `carried`.
    """

    def __init__(self, config: Config, nonce: int, carry_us: int = CARRY_US) -> None:
        self._config, self._carry_us = config, carry_us
        self._hash = config_hash(config)
        self._nonce = nonce
        self._seq = 0
        self._decoder = Decoder()
        self._exchanges: deque[Exchange] = deque(maxlen=EXCHANGES)
        self._session: int | None = None
        self._hello_due_us: int | None = None
        self._plan: Cmd | None = None
        self._plan_issued_us = 0
        self._plan_ends_us = 0  # without the extension
        self._refresh_due_us = 0
        self.board: HelloAck | None = None
        self.status: Status | None = None
        self.ack: Ack | None = None
        self.state: State | None = None  # from the newest frame of the board
        self.edges: list[tuple[int, int]] = []  # (board's clock [us], mask), until taken
        self.refusals: dict[Result, int] = {}

    # State of the board

    @property
    def greeted(self) -> bool:
        """Whether the board has answered HELLO."""
        return self._session is not None

    @property
    def clock(self) -> Exchange | None:
        """The best reading of the board's clock; None before the first."""
        return min(self._exchanges, key=lambda e: e.delay_us, default=None)

    @property
    def bad_frames(self) -> dict[str, int]:
        """Number of invalid frames from the board, by reason."""
        return self._decoder.bad

    # Frames to the board

    def _send(self, message: Message, now_us: int) -> bytes:
        self._seq = (self._seq + 1) & 0xFFFF
        return encode_message(message, self._seq, now_us % WRAP)

    def _need_session(self) -> int:
        if self._session is None:
            raise SessionError("the board has not answered HELLO: call hello() and receive() first")
        return self._session

    def hello(self, now_us: int) -> bytes:
        """Start a session. The board closes all valves and ends the previous session."""
        self._session = None
        self._plan = None
        self._hello_due_us = now_us + HELLO_RETRY_US
        return self._send(Hello(self._nonce), now_us)

    def arm(self, now_us: int) -> bytes:
        """Request ARMED; plans must follow before the watchdog trips."""
        self._plan = None  # a plan from before is not resumed
        return self._send(Arm(self._need_session()), now_us)

    def disarm(self, now_us: int) -> bytes:
        """Close all valves; needs no session."""
        self._plan = None
        return self._send(Disarm(), now_us)

    def bearing(self, on: bool, now_us: int) -> bytes:
        """Switch bearing air on or off."""
        return self._send(Bearing(self._need_session(), int(on)), now_us)

    def ping(self, now_us: int) -> bytes:
        """Request an ACK, which shows that the line works."""
        return self._send(Ping(), now_us)

    def apply(self, command: ValveCommand, now_us: int) -> bytes:
        """Send a plan; `due` repeats it until the next one."""
        issued_us = round(command.issued_at * 1e6)
        ends_us = round(command.valid_until * 1e6)
        spare = (0,) * (VALVES - len(command.on_us))
        plan = Cmd(
            session=self._need_session(),
            plan=command.seq % WRAP,
            age_us=0,
            ttl_us=ends_us - issued_us,
            on_us=(*command.on_us, *spare),
            offset_us=(*command.offset_us, *spare),
        )
        self._plan = carried(plan, self._carry_us, self._config)
        self._plan_issued_us, self._plan_ends_us = issued_us, ends_us
        return self._repeat(self._plan, now_us)

    def _repeat(self, plan: Cmd, now_us: int) -> bytes:
        self._refresh_due_us = now_us + REFRESH_US
        age_us = max(0, now_us - self._plan_issued_us)
        if now_us >= self._plan_ends_us:  # expired: stop repeating, so that the watchdog trips
            self._plan = None
            return b""
        if age_us:
            plan = Cmd(plan.session, plan.plan, age_us, plan.ttl_us, plan.on_us, plan.offset_us)
        return self._send(plan, now_us)

    @property
    def due_us(self) -> int | None:
        """Time at which `due` has the next frame; None: nothing scheduled."""
        if self._hello_due_us is not None:
            return self._hello_due_us
        return None if self._plan is None else self._refresh_due_us

    def due(self, now_us: int) -> bytes:
        """Frames due at this time: a repeated HELLO or plan. Call it often."""
        if self._hello_due_us is not None and now_us >= self._hello_due_us:
            return self.hello(now_us)
        if self._plan is not None and now_us >= self._refresh_due_us:
            return self._repeat(self._plan, now_us)
        return b""

    # Frames from the board

    def receive(self, data: bytes, now_us: int) -> list[Message]:
        """Decode bytes received from the board at `now_us`; returns their messages.

        Raises:
            SessionError: the board speaks another protocol, or was built for other limits.
        """
        messages = []
        for frame in self._decoder.feed(data):
            if frame.version != VERSION:
                raise SessionError(
                    f"the board speaks protocol {frame.version}, this program {VERSION}: flash the"
                    " firmware that belongs to this program"
                )
            try:
                message = frame.message
            except (KeyError, ValueError, struct.error):
                bad = self._decoder.bad
                bad["unknown"] = bad.get("unknown", 0) + 1
                continue
            self._take(message, frame, now_us)
            messages.append(message)
        return messages

    def _take(self, message: Message, frame: Frame, now_us: int) -> None:
        match message:
            case HelloAck():
                self._take_hello(message, frame, now_us)
            case Ack():
                self.ack = message
                self.state = message.state
                self._note_clock(message.t1_us, message.t2_us, frame.t_us, now_us)
                if message.result not in (Result.OK, Result.REFRESHED):
                    self.refusals[message.result] = self.refusals.get(message.result, 0) + 1
            case Status():
                self.status = message
                self.state = message.state
            case Edges():
                count = message.count
                self.edges += zip(message.at_us[:count], message.mask[:count], strict=True)
                del self.edges[:-EDGES_KEPT]

    def _take_hello(self, message: HelloAck, frame: Frame, now_us: int) -> None:
        if message.host_nonce != self._nonce:
            return  # answer to another program
        if message.config_hash != self._hash:
            raise SessionError(
                f"the board was built with limits {message.config_hash:08x}, the vehicle file gives"
                f" {self._hash:08x}: build and flash the firmware for this vehicle"
            )
        self.board = message
        self._session = message.session
        self.state = message.state
        self._hello_due_us = None
        self._exchanges.clear()
        self._note_clock(message.t1_us, message.t2_us, frame.t_us, now_us)

    def _note_clock(self, t1_us: int, t2_us: int, t3_us: int, t4_us: int) -> None:
        self._exchanges.append(exchange(t1_us, t2_us, t3_us, t4_us % WRAP))
