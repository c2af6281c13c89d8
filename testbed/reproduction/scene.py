"""Environments of the papers' simulations: orbits, leaders, obstacles, disturbances."""

import math

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from sim_twin.orbit.kepler import Orbit
from sim_twin.orbit.relative import Chief, chief_on
from testbed.core.vehicle import NonNegative, Positive
from testbed.reproduction.kernel.fleet import Place, Wave

Array = NDArray[np.float64]
Vector = tuple[float, float, float]

ZERO: Vector = (0.0, 0.0, 0.0)


class OrbitParams(Struct, frozen=True, forbid_unknown_fields=True):
    """A paper's table of the reference orbit."""

    a_km: Positive
    e: NonNegative
    i_deg: float = 0.0
    node_deg: float = 0.0
    perigee_deg: float = 0.0
    theta_deg: float = 0.0
    mu: Positive = 3.986e14  # [m^3/s^2]

    def orbit(self) -> Orbit:
        """The orbit, in SI units and radians."""
        return Orbit(
            1e3 * self.a_km, self.e, math.radians(self.i_deg), math.radians(self.node_deg),
            math.radians(self.perigee_deg), math.radians(self.theta_deg), self.mu,
        )  # fmt: skip

    def chief(self) -> Chief:
        """The chief on this orbit."""
        return chief_on(self.orbit())


class WaveParams(Struct, frozen=True, forbid_unknown_fields=True):
    """A vector over time: mean + sine sin(w t) + cosine cos(w t)."""

    mean: Vector = ZERO
    sine: Vector = ZERO
    cosine: Vector = ZERO
    w: Positive = 1.0  # [rad/s]

    def wave(self) -> Wave:
        """The wave for compiled code."""
        return Wave(np.array(self.mean), np.array(self.sine), np.array(self.cosine), self.w)


STILL = WaveParams()


class Leader(Struct, frozen=True, forbid_unknown_fields=True):
    """A leader: a moving point."""

    start: Vector  # [m]
    velocity: WaveParams  # [m/s]

    @property
    def top_accel(self) -> float:
        """Largest acceleration [m/s^2]."""
        a = self.velocity
        angle = np.linspace(0.0, 2.0 * np.pi, 3600)[:, None]
        push = np.array(a.sine) * np.cos(angle) - np.array(a.cosine) * np.sin(angle)
        return float(a.w * np.linalg.norm(push, axis=1).max())


class Obstacles(Struct, frozen=True, forbid_unknown_fields=True):
    """Obstacles, all with the same velocity."""

    start: tuple[Vector, ...] = ()  # [m]
    radius: Positive = 1.0  # danger radius [m]
    velocity: WaveParams = STILL  # [m/s]


NO_OBSTACLES = Obstacles()


def place(
    orbit: OrbitParams | None,
    goal: Vector = ZERO,
    goal_v: WaveParams = STILL,
    obstacles: Obstacles = NO_OBSTACLES,
    push: WaveParams = STILL,
    *,
    law_g_sign: float = 1.0,
    law_knows_coriolis: float = 1.0,
    law_knows_rate: bool = False,
    law_knows_push: bool = False,
    near: float = 0.0,
    far: float = 0.0,
    edges_at: int = 0,
    max_axis: float = math.inf,
) -> Place:
    """The `Place` for compiled code; without an orbit the drift consists of `push` only."""
    chief = (orbit or OrbitParams(7000.0, 0.0)).chief()
    centres = np.array(obstacles.start, dtype=float).reshape(-1, 3)
    return Place(
        orbit is not None, chief, np.array(goal), goal_v.wave(),
        centres, obstacles.velocity.wave(), np.full(len(centres), obstacles.radius), push.wave(),
        law_g_sign, law_knows_coriolis, law_knows_rate, law_knows_push, near, far, edges_at,
        max_axis,
    )  # fmt: skip
