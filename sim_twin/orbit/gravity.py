r"""Gravity of the Earth on many satellites at once: two-body and J2, in ECI.

Source: D. A. Vallado, "Fundamentals of Astrodynamics and Applications", 4th ed., 2013, section 8.6;
constants of EGM-96. The z axis of ECI is along the pole, so J2 does not depend on the Earth's
rotation.

    a = -mu r / |r|^3 [1 + (3/2) J2 (R/|r|)^2 ((1 - 5 s^2) (x, y), (3 - 5 s^2) z)],   s = z / |r|
"""

from typing import NamedTuple

from testbed.core.compiled import compiled


class Planet(NamedTuple):
    """Gravity parameters of a planet."""

    mu: float  # gravitational parameter [m^3/s^2]
    radius: float  # equatorial reference radius of J2 [m]
    j2: float  # [-], 0 for a point mass


EARTH = Planet(3.986004418e14, 6378136.3, 1.08262668e-3)  # EGM-96
POINT_EARTH = EARTH._replace(j2=0.0)


@compiled
def pull(planet, x, y, z):
    """Acceleration (ax, ay, az) [m/s^2] at one position [m]."""
    r2 = x * x + y * y + z * z
    s2 = z * z / r2
    point = -planet.mu / (r2 * r2**0.5)
    bulge = 1.5 * planet.j2 * planet.radius * planet.radius / r2
    across = point * (1.0 + bulge * (1.0 - 5.0 * s2))
    return across * x, across * y, point * (1.0 + bulge * (3.0 - 5.0 * s2)) * z


@compiled
def pull_all(planet, r, acceleration):
    """Write the acceleration [m/s^2] at each position in `r`, shape (n, 3) [m]."""
    for i in range(r.shape[0]):
        ax, ay, az = pull(planet, r[i, 0], r[i, 1], r[i, 2])
        acceleration[i, 0], acceleration[i, 1], acceleration[i, 2] = ax, ay, az
