"""Judges the vehicles in the minute after a flight."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Literal, Protocol

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from testbed.core.codes import FaultReport

MINUTE = 60.0  # time for an operator to reach the table [s]
HARD = 0.02  # slower contacts do no harm [m/s]
CREEP = 0.001  # below this a vehicle is at rest [m/s]
TURN = 0.01  # [rad/s]
STEP = 0.05  # between two samples of a vehicle [s]

Air = Literal["off", "on"]


class Left(Struct, frozen=True):
    """State of one vehicle after a flight."""

    at_rest_s: float | None  # after the end of the flight; null: it still moved a minute later [s]
    air: Air  # of its bearings


class After(Struct, frozen=True):
    """State of the vehicles after a flight: `after` of metrics.json."""

    contacts: int | None  # harder than 2 cm/s, until a minute after the end; null: without a twin
    at_rest_s: float | None  # until the last vehicle rests; null: one does not [s]
    air: Air  # on: at least one vehicle has bearing air
    vehicles: dict[str, Left]
    fault: FaultReport | None = None  # that ended a hold after the flight


class RecordedContact(Protocol):
    """A contact recorded by the plant."""

    @property
    def t(self) -> float:
        """Time of the contact [s]."""
        ...

    @property
    def speed(self) -> float:
        """Closing speed [m/s]."""
        ...


def contacts_after(touches: Iterable[RecordedContact], end: float) -> int:
    """Number of contacts harder than `HARD` after `end` [s], of those that were simulated."""
    return sum(end < touch.t and touch.speed > HARD for touch in touches)


def at_rest_after(t: NDArray[np.float64], twist: NDArray[np.float64], end: float) -> float | None:
    """Time from `end` until a vehicle came to rest and stayed so; None if it did not [s].

    Args:
        t: times, increasing, shape (n,) [s].
        twist: vx, vy, omega then, shape (n, 3).
        end: of the flight [s].
    """
    moves = (np.hypot(twist[:, 0], twist[:, 1]) > CREEP) | (np.abs(twist[:, 2]) > TURN)
    moving = np.flatnonzero(moves & (t >= end))
    if len(moving) == 0:
        return 0.0
    last = int(moving[-1])
    return float(t[last + 1] - end) if last + 1 < len(t) else None


def judge_after(
    names: Sequence[str],
    t: NDArray[np.float64],
    states: NDArray[np.float64],
    touches: Iterable[RecordedContact],
    floats: Mapping[str, bool],
    end: float,
) -> After:
    """Judge the minute after a flight.

    Args:
        names: of the vehicles.
        t: times, increasing, from the end of the flight on, shape (n,) [s].
        states: the truth then, shape (n, v, 6).
        touches: all of the run.
        floats: per vehicle, whether its bearing air is on at the end.
        end: of the flight [s].
    """
    vehicles = {
        name: Left(at_rest_after(t, states[:, k, 3:], end), "on" if floats[name] else "off")
        for k, name in enumerate(names)
    }
    rests = [left.at_rest_s for left in vehicles.values()]
    known = [rest for rest in rests if rest is not None]
    return After(
        contacts_after(touches, end),
        max(known, default=0.0) if len(known) == len(rests) else None,
        "on" if any(floats.values()) else "off",
        vehicles,
    )


def left_in_words(name: str, left: Left) -> str:
    """Text about a vehicle after a flight, for the operator."""
    rest = "still moving after a minute" if left.at_rest_s is None else (
        f"at rest after {left.at_rest_s:.1f} s"
    )  # fmt: skip
    return f"{name}: {rest}, bearing air {left.air}"
