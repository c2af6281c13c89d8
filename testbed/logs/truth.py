"""True poses of the vehicles, which only a twin knows."""

from msgspec import Struct


class Motion(Struct, frozen=True, gc=False):
    """Pose and twist of one vehicle in W."""

    x: float  # [m]
    y: float  # [m]
    theta: float  # [rad]
    vx: float  # [m/s]
    vy: float  # [m/s]
    omega: float  # [rad/s]


class Truth(Struct, frozen=True, gc=False):
    """True poses of the vehicles at a tick."""

    t: float  # [s]
    vehicles: dict[str, Motion]
