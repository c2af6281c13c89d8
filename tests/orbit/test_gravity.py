import numpy as np
import pytest

from sim_twin.orbit.frames import NADIR
from sim_twin.orbit.gravity import EARTH, POINT_EARTH, pull, pull_all
from sim_twin.orbit.swarm import fly
from sim_twin.orbit.system import Coast

# gao2022, Table 5: centre of the cluster in ECI [km, km/s]
TABLE_5 = {
    0: (-443.54295, 899.34186, -6898.0861, 7.4271828, 1.3587345, -0.29933858),
    1000: (5850.6303, 1530.4312, -3471.9062, 3.9039044, -0.22348015, 6.4713810),
    2000: (5917.3955, 533.21440, 3654.0846, -3.7823796, -1.5714632, 6.3527428),
}


def potential(r, planet):
    """Of the planet with its bulge [m^2/s^2], from which gravity must follow."""
    size = np.linalg.norm(r)
    sine = r[2] / size
    bulge = planet.j2 * (planet.radius / size) ** 2 * (3.0 * sine**2 - 1.0) / 2.0
    return planet.mu / size * (1.0 - bulge)


@pytest.mark.parametrize("planet", [EARTH, POINT_EARTH])
def test_gravity_is_the_gradient_of_its_potential(planet):
    rng = np.random.default_rng(1)
    for r in 7e6 * rng.normal(size=(20, 3)):
        h = 1e-4 * np.linalg.norm(r)
        gradient = [
            (8 * (potential(r + h * e, planet) - potential(r - h * e, planet))
             - potential(r + 2 * h * e, planet) + potential(r - 2 * h * e, planet)) / (12 * h)
            for e in np.eye(3)
        ]  # fmt: skip
        pulled = np.array(pull(planet, *r))
        assert pulled == pytest.approx(gradient, abs=1e-10 * np.linalg.norm(pulled))


def test_many_places_at_once_are_the_same_as_one_by_one():
    r = 7e6 * np.random.default_rng(2).normal(size=(7, 3))
    out = np.empty_like(r)
    pull_all(EARTH, r, out)
    assert out.tolist() == [list(pull(EARTH, *row)) for row in r]


def centre_after(seconds, planet):
    """The first column of Table 5, uncontrolled [km]."""
    start = 1e3 * np.array(TABLE_5[0])
    flight = fly(
        Coast(), start, np.zeros((1, 3)), np.zeros((1, 3)), (0.0, seconds),
        axes=NADIR, planet=planet,
    )  # fmt: skip
    return flight.centre[-1, :3] / 1e3


def test_the_papers_centre_flies_as_with_j2():
    gap = np.linalg.norm(centre_after(1000.0, EARTH) - TABLE_5[1000][:3])
    assert gap <= 0.1
    gap = np.linalg.norm(centre_after(2000.0, EARTH) - TABLE_5[2000][:3])
    assert gap <= 0.2


def test_the_papers_centre_does_not_fly_as_two_bodies():
    gap = np.linalg.norm(centre_after(1000.0, POINT_EARTH) - TABLE_5[1000][:3])
    assert gap == pytest.approx(10.0, abs=0.1)
