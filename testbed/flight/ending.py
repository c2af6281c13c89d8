"""How long a vehicle may brake before its air is shut off, at rest or not."""

from msgspec import Struct

from testbed.core.vehicle import NonNegative, Positive


class EndingParams(Struct, frozen=True, forbid_unknown_fields=True):
    """Limits of a stop."""

    brake_s: Positive = 6.0  # at most, however fast the vehicle was
    margin: Positive = 2.0  # times what its speed needs at the deceleration of its jets
    settle_s: NonNegative = 2.5  # on top, for the heading: 1.5 rad/s need 2.2 s


def longest_brake(params: EndingParams, speed: float, decel: float) -> float:
    """How long a stop may take [s].

    Args:
        params: of the experiment.
        speed: at its beginning [m/s].
        decel: what the jets can do in every direction [m/s^2].
    """
    return min(params.brake_s, params.settle_s + params.margin * speed / decel)
