"""Poses and references as rows of numbers: from the cameras and the law to the chain and the log.

A row becomes a struct when it is looked at. Making ten structs per tick, and taking them apart
again, took a tenth of a flight on the twin.
"""

from collections.abc import Iterable, Sequence
from itertools import chain
from operator import attrgetter
from typing import ClassVar, Self, TypeVar, overload

import numpy as np
from numpy.typing import NDArray

from testbed.core.types import Accel, Pose, PoseSample, Reference, Twist

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
        """The same structs as rows."""
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
    """References, rows in the order of record.REFERENCE."""

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


def structs_of(thing: object) -> list[object]:
    """The structs of rows: msgspec's `enc_hook` for messages with rows in them.

    Raises:
        NotImplementedError: for anything else.
    """
    if not isinstance(thing, Rows):
        raise NotImplementedError(f"{type(thing).__name__} in a message")
    return list(thing)
