"""The envelope of every message on the network, and the rules for refusing messages. Pure.

A message is refused after its valid-until, after a newer one was received, and if it belongs to
another session: a command of yesterday's run must not move a vehicle today.
"""

from collections.abc import Callable
from enum import StrEnum
from typing import Any, Generic, TypeVar

import msgspec
from msgspec import Struct

from testbed.core.types import LawMessage, Setpoint, State, Trajectory

M = TypeVar("M")

SCHEMA = 1  # version of the envelope and its contents; others are refused
LONGEST_S = 60.0  # longest lifetime of a message
EARLY_S = 0.05  # a message may arrive this long before its stamp: clocks differ


class Sealed(Struct, frozen=True, array_like=True, gc=False):
    """A message on the wire, in MessagePack. Times are of the run, by the host's clock."""

    schema: int
    session: int  # number of the run
    seq: int  # rises by one per message of a sender and key
    issued_at: float  # [s]
    valid_until: float  # [s]
    body: msgspec.Raw


class Acceptance(StrEnum):
    """Result of judging a message."""

    TAKEN = "taken"
    LATE = "late"  # its delay was too long
    EXPIRED = "expired"  # it arrived after its valid-until
    DUPLICATED = "duplicated"
    REORDERED = "reordered"  # a newer one arrived before it
    FOREIGN = "foreign"  # of another session
    SCHEMA = "schema"  # of another version of this program
    GARBLED = "garbled"  # not a message, or its stamp is in the future


class Outbox:
    """Numbers and seals the messages of one key."""

    def __init__(self, session: int) -> None:
        self._session, self.sent = session, 0
        self._pack = msgspec.msgpack.Encoder().encode

    def seal(self, message: object, issued_at: float, valid_until: float) -> bytes:
        """Encode a message with the next sequence number."""
        self.sent += 1
        body = msgspec.Raw(self._pack(message))
        return self._pack(Sealed(SCHEMA, self._session, self.sent, issued_at, valid_until, body))


_head = msgspec.msgpack.Decoder(Sealed)


class Inbox(Generic[M]):
    """The newest message of one key, and how many were refused and why.

    Args:
        open_body: decodes the body.
        session: messages of other sessions are refused.
        late_s: longest delay from issue to arrival.
    """

    def __init__(self, open_body: Callable[[Any], M], session: int, late_s: float) -> None:
        self._open, self._session, self._late_s = open_body, session, late_s
        self._seq = 0
        self.newest: M | None = None
        self.valid_until = self.issued_at = -float("inf")  # of the newest message
        self.counts = dict.fromkeys(Acceptance, 0)
        self.missed = 0  # lost messages, from gaps in the sequence numbers
        self.delay: float | None = None  # of the newest message, from issue to arrival [s]

    @property
    def foreign(self) -> int:
        """Number of messages of another session so far."""
        return self.counts[Acceptance.FOREIGN]

    def take(self, data: bytes, arrived_at: float) -> Acceptance:
        """Judge a message that arrived at this time of the run."""
        verdict = self._judge(data, arrived_at)
        self.counts[verdict] += 1
        return verdict

    def _judge(self, data: bytes, arrived_at: float) -> Acceptance:
        try:
            head = _head.decode(data)
            if head.schema != SCHEMA:
                return Acceptance.SCHEMA
            if head.session != self._session:
                return Acceptance.FOREIGN
            if head.seq <= self._seq:
                return Acceptance.DUPLICATED if head.seq == self._seq else Acceptance.REORDERED
            if not arrived_at <= head.valid_until:
                return Acceptance.EXPIRED
            if not arrived_at - head.issued_at <= self._late_s:
                return Acceptance.LATE
            if not arrived_at - head.issued_at >= -EARLY_S:
                return Acceptance.GARBLED
            if not head.valid_until - head.issued_at <= LONGEST_S:
                return Acceptance.GARBLED
            message = self._open(head.body)
        except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError):
            return Acceptance.GARBLED
        if self._seq:
            self.missed += head.seq - self._seq - 1
        self.delay = arrived_at - head.issued_at
        self._seq, self.newest, self.valid_until = head.seq, message, head.valid_until
        self.issued_at = head.issued_at
        return Acceptance.TAKEN


_state = msgspec.msgpack.Decoder(State).decode
_setpoint = msgspec.msgpack.Decoder(Setpoint).decode
_law_message = msgspec.msgpack.Decoder(LawMessage).decode


def open_state(data: Any) -> State:
    """Decode a vehicle's state; all numbers must be finite and below 1e9."""
    state: State = _state(data)
    pose, twist, bias = state.pose, state.twist, state.bias
    _insist(
        state.t, pose.x, pose.y, pose.theta, twist.vx, twist.vy, twist.omega,
        bias.ax, bias.ay, bias.alpha, state.pose_age,
    )  # fmt: skip
    return state


def open_setpoint(data: Any) -> Setpoint:
    """Decode a setpoint, with the same limit; a trajectory must not be empty."""
    setpoint: Setpoint = _setpoint(data)
    if isinstance(setpoint, Trajectory):
        if not setpoint.references:
            raise msgspec.ValidationError("an empty trajectory")
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
    """Decode a law's message, with the same limit."""
    message: LawMessage = _law_message(data)
    _insist(message.t, *message.values)
    return message


def _insist(*values: float) -> None:
    for value in values:
        if not abs(value) < 1e9:  # also nan
            raise msgspec.ValidationError(f"a number of {value}")
