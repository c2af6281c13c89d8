"""The envelope of every message on the network, and the rules for refusing messages. Pure.

A message is refused after its valid-until, after a newer one was received, and if it belongs to
another session: a command of yesterday's run must not move a vehicle today.
"""

from collections.abc import Callable
from enum import StrEnum
from typing import Any, Generic, NamedTuple, TypeVar

import msgspec

from testbed.core.records.layout import HEADER
from testbed.logs.packing import several
from testbed.net.payload import body_of

M = TypeVar("M")

SCHEMA = 2  # version of the envelope and its contents; others are refused
LONGEST_S = 60.0  # longest lifetime of a message
EARLY_S = 0.05  # a message may arrive this long before its stamp: clocks differ


_ENVELOPE = several("Envelope", 1)
START = len(HEADER) + _ENVELOPE.size  # of the body [bytes]


class Head(NamedTuple):
    """The envelope of a message: the record `Envelope`, as CDR. Its body follows."""

    session: int
    seq: int
    issued_at: float  # [s]
    valid_until: float  # [s]
    schema: int


def head_of(data: bytes) -> Head | None:
    """The envelope of a message; None: it has none."""
    if len(data) < START or data[: len(HEADER)] != HEADER:
        return None
    return Head(*_ENVELOPE.unpack_from(data, len(HEADER)))


class Verdict(StrEnum):
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

    def seal(self, message: object, issued_at: float, valid_until: float) -> bytes:
        """Encode a message with the next sequence number."""
        self.sent += 1
        head = _ENVELOPE.pack(self._session, self.sent, issued_at, valid_until, SCHEMA)
        return HEADER + head + body_of(message)


class Inbox(Generic[M]):
    """The newest message of one key, and how many were refused and why.

    Args:
        open_body: decodes the body, see payload.py.
        session: messages of other sessions are refused.
        late_s: longest delay from issue to arrival.
    """

    def __init__(self, open_body: Callable[[Any], M], session: int, late_s: float) -> None:
        self._open, self._session, self._late_s = open_body, session, late_s
        self._seq = 0
        self.newest: M | None = None
        self.valid_until = self.issued_at = -float("inf")  # of the newest message
        self.counts = dict.fromkeys(Verdict, 0)
        self.missed = 0  # lost messages, from gaps in the sequence numbers
        self.delay: float | None = None  # of the newest message, from issue to arrival [s]

    @property
    def foreign(self) -> int:
        """Number of messages of another session so far."""
        return self.counts[Verdict.FOREIGN]

    def take(self, data: bytes, arrived_at: float) -> Verdict:
        """Judge a message that arrived at this time of the run."""
        verdict = self._judge(data, arrived_at)
        self.counts[verdict] += 1
        return verdict

    def _judge(self, data: bytes, arrived_at: float) -> Verdict:
        if (head := head_of(data)) is None:
            return Verdict.GARBLED
        try:
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
            message = self._open(data[START:])
        except (msgspec.MsgspecError, ValueError, RecursionError):
            return Verdict.GARBLED
        if self._seq:
            self.missed += head.seq - self._seq - 1
        self.delay = arrived_at - head.issued_at
        self._seq, self.newest, self.valid_until = head.seq, message, head.valid_until
        self.issued_at = head.issued_at
        return Verdict.TAKEN
