r"""Keplerian orbits: elements, position at any time, elements <-> ECI.

Source: D. A. Vallado, "Fundamentals of Astrodynamics and Applications", 4th ed., 2013, chapter 2.

    textbook     code           meaning                                             unit
    a, e         a, e           semi-major axis, eccentricity (0 <= e < 1)          m, -
    i, Omega     i, node        inclination, right ascension of the ascending node  rad
    omega, nu    perigee, theta argument of perigee, true anomaly                   rad

An undefined angle (node of an equatorial orbit, perigee of a circular one) is zero and the next
angle counts from there: on a circular orbit `theta` is the argument of latitude.
"""

import math

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from sim_twin.orbit.gravity import EARTH
from testbed.core.compiled import compiled

Array = NDArray[np.float64]

TURN = 2.0 * math.pi
FLAT = 1e-11  # [-] below this sine or eccentricity an angle is undefined


class Orbit(Struct, frozen=True, forbid_unknown_fields=True):
    """An elliptic orbit and the satellite's position on it at time 0."""

    a: float  # semi-major axis [m]
    e: float = 0.0  # eccentricity [-]
    i: float = 0.0  # inclination [rad]
    node: float = 0.0  # right ascension of the ascending node [rad]
    perigee: float = 0.0  # argument of perigee [rad]
    theta: float = 0.0  # true anomaly at time 0 [rad]
    mu: float = EARTH.mu  # [m^3/s^2]

    def __post_init__(self) -> None:
        if not 0.0 <= self.e < 1.0:
            raise ValueError(f"expected an elliptic orbit, 0 <= e < 1, found e = {self.e}")
        if not 0.0 < self.a < math.inf:
            raise ValueError(f"expected a semi-major axis a > 0 [m], found a = {self.a}")
        if not 0.0 < self.mu < math.inf:
            raise ValueError(f"expected mu > 0 [m^3/s^2], found mu = {self.mu}")

    @property
    def mean_motion(self) -> float:
        """Mean motion n [rad/s]."""
        return math.sqrt(self.mu / self.a**3)

    @property
    def momentum(self) -> float:
        """Angular momentum per mass, h [m^2/s]."""
        return math.sqrt(self.mu * self.a * (1.0 - self.e * self.e))

    def theta_at(self, t: float) -> float:
        """True anomaly at time `t` [rad], continuous over revolutions."""
        start = mean_of_true(self.theta, self.e)
        return true_of_mean(start + self.mean_motion * t, self.e)

    def eci(self, t: float = 0.0) -> tuple[Array, Array]:
        """Position [m] and velocity [m/s] at time `t`, each of shape (3,)."""
        theta = self.theta_at(t)
        p = self.a * (1.0 - self.e * self.e)
        r = p / (1.0 + self.e * math.cos(theta))
        speed = math.sqrt(self.mu / p)
        axes = rotation(self.i, self.node, self.perigee)
        cos, sin = math.cos(theta), math.sin(theta)
        return (
            axes @ np.array((r * cos, r * sin, 0.0)),
            axes @ np.array((-speed * sin, speed * (self.e + cos), 0.0)),
        )


def one_turn(angle: float) -> float:
    """`angle` wrapped to [0, 2 pi) [rad]."""
    inside = angle % TURN
    return inside if inside < TURN else 0.0  # a tiny negative angle is rounded to 2 pi


def rotation(i: float, node: float, perigee: float) -> Array:
    """Perifocal axes (to the perigee, a quarter turn on, normal) in ECI, as columns (3, 3)."""
    co, so = math.cos(node), math.sin(node)
    ci, si = math.cos(i), math.sin(i)
    cw, sw = math.cos(perigee), math.sin(perigee)
    return np.array(
        (
            (co * cw - so * sw * ci, -co * sw - so * cw * ci, so * si),
            (so * cw + co * sw * ci, -so * sw + co * cw * ci, -co * si),
            (sw * si, cw * si, ci),
        )
    )


def orbit_of(r: Array, v: Array, mu: float = EARTH.mu) -> Orbit:
    """The orbit through position `r` [m] with velocity `v` [m/s] in ECI, at time 0.

    Raises:
        ValueError: the orbit is not an ellipse.
    """
    r, v = np.asarray(r, dtype=float), np.asarray(v, dtype=float)
    distance = float(np.linalg.norm(r))
    energy = 0.5 * float(v @ v) - mu / distance if distance > 0.0 else -math.inf
    h = np.cross(r, v)
    size = float(np.linalg.norm(h))
    if not (energy < 0.0 and size > 0.0):
        raise ValueError(
            f"expected an elliptic orbit (energy < 0, not straight down), "
            f"found energy {energy:.6g} J/kg and |r x v| = {size:.6g} m^2/s"
        )
    normal = h / size
    eccentricity = np.cross(v, h) / mu - r / distance
    e = float(np.linalg.norm(eccentricity))
    sine = math.hypot(normal[0], normal[1])
    inclination = math.atan2(sine, normal[2])
    node = one_turn(math.atan2(normal[0], -normal[1])) if sine > FLAT else 0.0
    ahead = np.array((math.cos(node), math.sin(node), 0.0))  # to the ascending node
    up = np.cross(normal, ahead)
    e = e if e > FLAT else 0.0
    perigee = one_turn(math.atan2(eccentricity @ up, eccentricity @ ahead)) if e else 0.0
    latitude = math.atan2(r @ up, r @ ahead)
    theta = one_turn(latitude - perigee)
    return Orbit(-mu / (2.0 * energy), e, inclination, node, perigee, theta, mu)


@compiled
def eccentric_of_mean(mean, e):
    """Solve Kepler's equation E - e sin E = M by Newton's method [rad]."""
    turns = np.floor(mean / TURN + 0.5) * TURN
    m = mean - turns
    x = m + e * np.sin(m) / (1.0 - np.sin(m + e) + np.sin(m)) if e < 0.8 else np.pi * np.sign(m)
    for _ in range(50):
        step = (x - e * np.sin(x) - m) / (1.0 - e * np.cos(x))
        x -= step
        if abs(step) <= 4e-16 * (1.0 + abs(x)):
            break
    return x + turns


@compiled
def true_of_mean(mean, e):
    """True anomaly of a mean anomaly [rad]; both continuous over revolutions."""
    x = eccentric_of_mean(mean, e)
    beta = e / (1.0 + np.sqrt(1.0 - e * e))
    return x + 2.0 * np.arctan(beta * np.sin(x) / (1.0 - beta * np.cos(x)))


@compiled
def mean_of_true(theta, e):
    """Mean anomaly of a true anomaly [rad]; both continuous over revolutions."""
    beta = e / (1.0 + np.sqrt(1.0 - e * e))
    x = theta - 2.0 * np.arctan(beta * np.sin(theta) / (1.0 + beta * np.cos(theta)))
    return x - e * np.sin(x)
