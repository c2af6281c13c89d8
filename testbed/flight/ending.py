"""How a flight ends: whether vehicles hold position first, and how long they may brake."""

from typing import Literal

from msgspec import Struct

from testbed.core.vehicle import NonNegative, Positive


class EndingParams(Struct, frozen=True, forbid_unknown_fields=True):
    """After a flight that ended as planned, and limits of a stop."""

    after: Literal["stand", "hold"] = "stand"  # hold: stay in place until stopped, then stand
    hold_s: Positive = 300.0  # longest hold
    brake_s: Positive = 6.0  # upper limit at any speed
    margin: Positive = 2.0  # factor on the time that its speed needs at its jets' deceleration
    settle_s: NonNegative = 2.5  # added for the heading: 1.5 rad/s needs 2.2 s
