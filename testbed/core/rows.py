"""Poses, states, references and messages as rows of numbers, as compiled code takes them.

A row becomes a struct when it is looked at. Making ten structs per tick, and taking them apart
again, took a tenth of a flight on the twin.
"""

import math
from collections.abc import Iterable, Sequence
from itertools import chain
from operator import attrgetter
from typing import ClassVar, Self, TypeVar, overload

import numpy as np
from numpy.typing import NDArray

from testbed.core.compiled import compiled
from testbed.core.records.kinds import SetpointKind
from testbed.core.types import (
    Accel,
    Demand,
    LawMessage,
    Pose,
    PoseSample,
    Reference,
    Setpoint,
    State,
    Trajectory,
    Twist,
)

Array = NDArray[np.float64]
S = TypeVar("S")


class Rows(Sequence[S]):
    """A sequence of structs, kept as the rows of an array that does not change any more."""

    __slots__ = ("rows",)
    width: ClassVar[int]  # of a row
    numbers: ClassVar[attrgetter]  # of a struct, in the order of a row

    def __init__(self, rows: Array) -> None:
        self.rows = rows

    @classmethod
    def of(cls, structs: Sequence[S]) -> Self:
        """These structs as rows; rows stay as they are."""
        return structs if isinstance(structs, cls) else cls.from_numbers(map(cls.numbers, structs))

    @classmethod
    def from_numbers(cls, rows: Iterable[Sequence[float]]) -> Self:
        """The rows that these numbers are, one struct each."""
        numbers = list(chain.from_iterable(rows))
        return cls(np.array(numbers, dtype=np.float64).reshape(-1, cls.width))

    @staticmethod
    def struct(row: list[float]) -> S:
        """The struct of a row."""
        raise NotImplementedError

    def __len__(self) -> int:
        return len(self.rows)

    @overload
    def __getitem__(self, k: int) -> S: ...
    @overload
    def __getitem__(self, k: slice) -> Self: ...
    def __getitem__(self, k: int | slice) -> S | Self:
        if isinstance(k, slice):
            return type(self)(np.ascontiguousarray(self.rows[k]))
        return self.struct(self.rows[k].tolist())

    def __eq__(self, other: object) -> bool:
        if isinstance(other, type(self)):
            return np.array_equal(self.rows, other.rows)
        return isinstance(other, Sequence) and tuple(self) == tuple(other)

    __hash__ = None  # type: ignore[assignment]

    def __repr__(self) -> str:
        return repr(tuple(self))


class PoseSamples(Rows[PoseSample]):
    """Poses, rows (captured at [s], x [m], y [m], theta [rad])."""

    __slots__ = ()
    width, numbers = 4, attrgetter("captured_at", "x", "y", "theta")

    @staticmethod
    def struct(row: list[float]) -> PoseSample:
        """See `Rows`."""
        return PoseSample(*row)


class References(Rows[Reference]):
    """References, rows in the order of flight.record.REFERENCE."""

    __slots__ = ()
    width = 10
    numbers = attrgetter(
        "t", "pose.x", "pose.y", "pose.theta", "twist.vx", "twist.vy", "twist.omega",
        "accel.ax", "accel.ay", "accel.alpha",
    )  # fmt: skip

    @staticmethod
    def struct(row: list[float]) -> Reference:
        """See `Rows`."""
        t, x, y, theta, vx, vy, omega, ax, ay, alpha = row
        return Reference(t, Pose(x, y, theta), Twist(vx, vy, omega), Accel(ax, ay, alpha))


class States(Rows[State]):
    """Estimates, rows in the order of flight.record.STATE after its `known`."""

    __slots__ = ()
    width = 12
    numbers = attrgetter(
        "t", "pose.x", "pose.y", "pose.theta", "twist.vx", "twist.vy", "twist.omega",
        "bias.ax", "bias.ay", "bias.alpha", "pose_age", "rejected",
    )  # fmt: skip

    @staticmethod
    def struct(row: list[float]) -> State:
        """See `Rows`."""
        t, x, y, theta, vx, vy, omega, ax, ay, alpha, age, rejected = row
        bias = Accel(ax, ay, alpha)
        return State(t, Pose(x, y, theta), Twist(vx, vy, omega), bias, age, int(rejected))


SETPOINT_WIDTH = 8  # numbers of a setpoint without its references


def numbers_of(setpoint: Setpoint | None) -> tuple[float, ...]:
    """A setpoint without its references, in the order of flight.record.SETPOINT."""
    if setpoint is None:
        return SetpointKind.NONE, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    if isinstance(setpoint, Trajectory):
        begins = References.of(setpoint.references).rows[0, 0]
        return SetpointKind.TRAJECTORY, begins, setpoint.valid_until, 0.0, 0.0, 0.0, 0.0, 0.0
    one, kind = setpoint, SetpointKind.DEMAND
    return kind, one.t, one.valid_until, one.fx_w, one.fy_w, one.theta, one.omega, one.alpha


FORCE = 3  # column of the force of a demand in its row
NEWEST = References.width  # numbers of the newest reference, at the end of a trajectory's row


@compiled
def is_finite(row):
    """Whether a setpoint can be flown: of a trajectory the newest reference, else the demand.

    Args:
        row: see `row_of_setpoint`.
    """
    total = 0.0
    for i in range(max(FORCE, row.shape[0] - NEWEST), row.shape[0]):
        total += row[i]
    return math.isfinite(total)


def row_of_setpoint(setpoint: Setpoint) -> Array:
    """A setpoint as one row: its numbers, then its references one after the other."""
    head = np.array(numbers_of(setpoint), dtype=np.float64)
    if isinstance(setpoint, Demand):
        return head
    return np.concatenate((head, References.of(setpoint.references).rows.ravel()))


def setpoint_of(row: Array) -> Setpoint:
    """The setpoint in a row, see `row_of_setpoint`."""
    kind, t, until, fx, fy, theta, omega, alpha = row[:SETPOINT_WIDTH].tolist()
    if kind == SetpointKind.DEMAND:
        return Demand(t, fx, fy, theta, omega, alpha, until)
    return Trajectory(References(row[SETPOINT_WIDTH:].reshape(-1, References.width)), until)


def row_of_message(message: LawMessage) -> Array:
    """A law's message as one row: its time, then its values."""
    return np.array((message.t, *message.values), dtype=np.float64)


def message_of(row: Array) -> LawMessage:
    """The message in a row, see `row_of_message`."""
    t, *values = row.tolist()
    return LawMessage(t, tuple(values))


def structs_of(thing: object) -> list[object]:
    """The structs of rows: msgspec's `enc_hook` for messages with rows in them.

    Raises:
        NotImplementedError: for anything else.
    """
    if not isinstance(thing, Rows):
        raise NotImplementedError(f"{type(thing).__name__} in a message")
    return list(thing)
