"""Limits how long a vehicle may brake before its air is turned off, at rest or not."""

from msgspec import Struct

from testbed.core.vehicle import NonNegative, Positive


class EndingParams(Struct, frozen=True, forbid_unknown_fields=True):
    """Longest braking time, and margins on the expected one."""

    brake_s: Positive = 6.0  # upper limit at any speed
    margin: Positive = 2.0  # factor on the time that its speed needs at its jets' deceleration
    settle_s: NonNegative = 2.5  # added for the heading: 1.5 rad/s needs 2.2 s
