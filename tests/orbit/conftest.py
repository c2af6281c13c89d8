"""Orbits of the papers, and a two-body propagation that shares no code with the simulators."""

import math

import numpy as np
import pytest
from hypothesis import settings
from scipy.integrate import solve_ivp

from sim_twin.orbit.kepler import Orbit

settings.register_profile("seeded", derandomize=True, deadline=None)
settings.load_profile("seeded")

MU = 3.986004418e14  # [m^3/s^2]


@pytest.fixture(scope="session")
def gao_orbit():
    """600 km, 98 degrees, e = 0.0002: Section 3 of gao2022."""
    return Orbit(a=6978.0e3, e=0.0002, i=math.radians(98.0), node=0.4, perigee=1.1, theta=0.3)


@pytest.fixture(scope="session")
def zhang_orbit():
    """a = 7000 km, e = 0.3: Section 4 of zhang2023. Its perigee lies inside the Earth."""
    return Orbit(a=7000.0e3, e=0.3)


@pytest.fixture(scope="session")
def fly_inertially():
    """Chief and deputy as two bodies, thrust given in the chief's frame; separately written.

    Returns p and p' of the deputy in the chief's rotating frame at the times asked for.
    """

    def axes_of(r, v):
        normal = np.cross(r, v)
        out = r / np.linalg.norm(r)
        normal = normal / np.linalg.norm(normal)
        return np.array([out, np.cross(normal, out), normal])

    def fly(a, e, theta, p, v, thrust, times):
        distance = a * (1 - e**2) / (1 + e * math.cos(theta))
        h = math.sqrt(MU * a * (1 - e**2))
        chief_r = distance * np.array([math.cos(theta), math.sin(theta), 0.0])
        chief_v = MU / h * np.array([-math.sin(theta), e + math.cos(theta), 0.0])
        turning = np.array([0.0, 0.0, h / distance**2])
        axes = axes_of(chief_r, chief_v)
        deputy_r = chief_r + axes.T @ p
        deputy_v = chief_v + axes.T @ (v + np.cross(turning, p))

        def rate(t, y):
            r, w, q, u = y[:3], y[3:6], y[6:9], y[9:]
            push = axes_of(r, w).T @ thrust(t)
            pull = [-MU * x / math.sqrt(x @ x) ** 3 for x in (r, q)]
            return np.concatenate([w, pull[0], u, pull[1] + push])

        found = solve_ivp(
            rate, (times[0], times[-1]), np.concatenate([chief_r, chief_v, deputy_r, deputy_v]),
            method="DOP853", t_eval=times, rtol=1e-13, atol=1e-9, max_step=20.0,
        )  # fmt: skip
        assert found.success
        p_of, v_of = [], []
        for y in found.y.T:
            axes = axes_of(y[:3], y[3:6])
            turning = np.cross(y[:3], y[3:6]) / (y[:3] @ y[:3])
            apart = y[6:9] - y[:3]
            p_of.append(axes @ apart)
            v_of.append(axes @ (y[9:] - y[3:6] - np.cross(turning, apart)))
        return np.array(p_of), np.array(v_of)

    return fly
