"""What every message on the network is wrapped in, and what is refused. Pure.

A message is worth nothing after its valid-until, nothing when a newer one was heard, and nothing
when it belongs to another session: a command of yesterday's run must not move a vehicle today.
"""

from collections.abc import Callable
from enum import StrEnum
from typing import Any, Generic, TypeVar

import msgspec
from msgspec import Struct

from testbed.core.types import LawMessage, Setpoint, State, Trajectory

M = TypeVar("M")

SCHEMA = 1  # of the envelope and everything in it; others are refused
LONGEST_S = 60.0  # that a message may be worth anything
EARLY_S = 0.05  # a message may come so long before it was issued: clocks are never the same


class Sealed(Struct, frozen=True, array_like=True, gc=False):
    """A message on the wire, in MessagePack. Times are of the run, by the host's clock."""

    schema: int
    session: int  # of the run
    seq: int  # rises by one per message of a sender and key
    issued_at: float  # [s]
    valid_until: float  # [s]
    body: msgspec.Raw


class Verdict(StrEnum):
    """What became of a message."""

    TAKEN = "taken"
    LATE = "late"  # it was too long on the way
    EXPIRED = "expired"  # it was on the way until it was worth nothing
    DUPLICATED = "duplicated"
    REORDERED = "reordered"  # a newer one was faster
    FOREIGN = "foreign"  # of another session
    SCHEMA = "schema"  # of another version of this program
    GARBLED = "garbled"  # not a message at all, or one from the future


class Outbox:
    """Numbers and seals the messages of one key."""

    def __init__(self, session: int) -> None:
        self._session, self.sent = session, 0
        self._pack = msgspec.msgpack.Encoder().encode

    def seal(self, message: object, issued_at: float, valid_until: float) -> bytes:
        """The next message."""
        self.sent += 1
        body = msgspec.Raw(self._pack(message))
        return self._pack(Sealed(SCHEMA, self._session, self.sent, issued_at, valid_until, body))


_head = msgspec.msgpack.Decoder(Sealed)


class Inbox(Generic[M]):
    """The newest message of one key, and how many were refused and why.

    Args:
        open_body: decodes the message itself.
        session: that is listened to.
        late_s: longest time on the way.
    """

    def __init__(self, open_body: Callable[[Any], M], session: int, late_s: float) -> None:
        self._open, self._session, self._late_s = open_body, session, late_s
        self._seq = 0
        self.newest: M | None = None
        self.valid_until = self.issued_at = -float("inf")  # of the newest
        self.counts = dict.fromkeys(Verdict, 0)
        self.missed = 0  # messages that never came, by the numbers of those that did
        self.delay: float | None = None  # of the newest, from issue to arrival [s]

    @property
    def foreign(self) -> int:
        """Messages of another session so far."""
        return self.counts[Verdict.FOREIGN]

    def take(self, data: bytes, arrived_at: float) -> Verdict:
        """Judge a message that came in at this time of the run."""
        verdict = self._judge(data, arrived_at)
        self.counts[verdict] += 1
        return verdict

    def _judge(self, data: bytes, arrived_at: float) -> Verdict:
        try:
            head = _head.decode(data)
            if head.schema != SCHEMA:
                return Verdict.SCHEMA
            if head.session != self._session:
                return Verdict.FOREIGN
            if head.seq <= self._seq:
                return Verdict.DUPLICATED if head.seq == self._seq else Verdict.REORDERED
            if not arrived_at <= head.valid_until:
                return Verdict.EXPIRED
            if not arrived_at - head.issued_at <= self._late_s:
                return Verdict.LATE
            if not arrived_at - head.issued_at >= -EARLY_S:
                return Verdict.GARBLED
            if not head.valid_until - head.issued_at <= LONGEST_S:
                return Verdict.GARBLED
            message = self._open(head.body)
        except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError):
            return Verdict.GARBLED
        if self._seq:
            self.missed += head.seq - self._seq - 1
        self.delay = arrived_at - head.issued_at
        self._seq, self.newest, self.valid_until = head.seq, message, head.valid_until
        self.issued_at = head.issued_at
        return Verdict.TAKEN


_state = msgspec.msgpack.Decoder(State).decode
_setpoint = msgspec.msgpack.Decoder(Setpoint).decode
_law_message = msgspec.msgpack.Decoder(LawMessage).decode


def open_state(data: Any) -> State:
    """A vehicle's state; only finite numbers of a size that means something."""
    state: State = _state(data)
    pose, twist, bias = state.pose, state.twist, state.bias
    _insist(
        state.t, pose.x, pose.y, pose.theta, twist.vx, twist.vy, twist.omega,
        bias.ax, bias.ay, bias.alpha, state.pose_age,
    )  # fmt: skip
    return state


def open_setpoint(data: Any) -> Setpoint:
    """A setpoint, likewise; a trajectory has something in it."""
    setpoint: Setpoint = _setpoint(data)
    if isinstance(setpoint, Trajectory):
        if not setpoint.references:
            raise msgspec.ValidationError("a trajectory of nothing")
        for r in setpoint.references:
            pose, twist, accel = r.pose, r.twist, r.accel
            _insist(
                r.t, pose.x, pose.y, pose.theta, twist.vx, twist.vy, twist.omega,
                accel.ax, accel.ay, accel.alpha, setpoint.valid_until,
            )  # fmt: skip
    else:
        _insist(
            setpoint.t, setpoint.fx_w, setpoint.fy_w, setpoint.theta, setpoint.omega,
            setpoint.alpha, setpoint.valid_until,
        )  # fmt: skip
    return setpoint


def open_message(data: Any) -> LawMessage:
    """What a law says, likewise."""
    message: LawMessage = _law_message(data)
    _insist(message.t, *message.values)
    return message


def _insist(*values: float) -> None:
    for value in values:
        if not abs(value) < 1e9:  # also nan
            raise msgspec.ValidationError(f"a number of {value}")
