"""What the proofs ask of a start: V and phi_min by hand, and a name for what is missing."""

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.optimize import minimize

from controllers.bounded_potential import BoundedPotential
from controllers.certificate import (
    certificate,
    energy,
    least_spring_energy,
    sgn_certificate,
    spring_energy,
    starting,
)
from controllers.graph import FormationParams
from controllers.proxy import ProxyParams, coupling
from testbed.core.law import Discs

NAMES = ("a", "b", "c")
START = np.array([[-1.2, 0.1], [0.0, 0.0], [1.1, 0.3]])
REST, NOWHERE = np.zeros((3, 2)), np.zeros(2)
MASS = np.array([15.0, 15.0, 15.0])


def table(weight=0.284, height=0.2, led=False, **changes):
    distances = {"a-b": 1.5, "b-c": 1.5, "a-c": 2.5} | ({"c-leader": 1.5} if led else {})
    shape = FormationParams(
        range=2.0, safe=0.5, far_margin=0.2, near_margin=0.2, distances=distances
    )
    given = {"spring": 12.0, "limit": 0.8, "weight": weight, "height": height} | changes
    return coupling(ProxyParams(**given), shape, NAMES, led)


def names(concerns):
    return [c.name for c in concerns]


@pytest.mark.parametrize("reach", [0.03, 0.2])
def test_spring_energy_is_the_integral_of_its_force(reach):
    c = table()
    area, _ = quad(lambda x: min(c.spring * x, c.limit), 0.0, reach, points=[c.limit / c.spring])
    assert spring_energy(c, np.array([reach, -reach])) == pytest.approx(2.0 * area)


@pytest.mark.parametrize("spring", [2.0, 12.0])
def test_least_spring_energy_on_the_sphere_is_on_an_axis(spring):
    c = table(spring=spring)

    def on_sphere(angles):
        a, b = angles
        unit = np.array([np.cos(a) * np.cos(b), np.sin(a) * np.cos(b), np.sin(b)])
        return float(spring_energy(c, 0.1 * unit))

    starts = np.random.default_rng(0).uniform(-1.5, 1.5, (20, 2))
    found = min(minimize(on_sphere, x, method="Nelder-Mead").fun for x in starts)
    assert least_spring_energy(c) == pytest.approx(found, rel=1e-6)


def test_the_tables_least_spring_energy():
    # rho = 12 N/m, f_s = 0.8 N, epsilon = 0.2 m
    assert least_spring_energy(table()) == pytest.approx(0.8 * 0.1 - 0.8**2 / 24.0)


def test_energy_counts_every_edge_once_and_the_leaders_velocity():
    c = table(led=True)
    leader_p, leader_v = np.array([2.4, 0.1]), np.array([0.01, 0.0])
    whole = starting(MASS, START, REST, leader_p, leader_v)

    def psi(x, d, near=0.7, far=1.8, q=0.2):
        return (x - d) ** 2 * (far - x) / ((x - near) + (d - near) ** 2 * (far - x) / q)

    ends = [(START[0], START[1]), (START[1], START[2]), (START[2], leader_p)]
    edges = sum(psi(np.linalg.norm(a - b), 1.5) for a, b in ends)
    kinetic = 0.5 * 3 * (15.0 + 1.0) * 0.01**2
    assert energy(c, whole, c.formation.first) == pytest.approx(kinetic + 0.284 * edges)


def test_a_start_with_the_guarantee_raises_no_concern():
    whole = starting(MASS, START, REST, NOWHERE, NOWHERE)
    assert certificate(table(), whole, max_force=1.2) == []


def test_the_leaders_velocity_alone_can_break_the_guarantee():
    c, leader_p = table(weight=0.18, height=0.3, led=True), np.array([2.4, 0.1])
    slow = starting(MASS, START, REST, leader_p, np.array([0.01, 0.0]))
    fast = slow._replace(leader_v=np.array([0.1, 0.0]))
    assert certificate(c, slow, 1.2) == []
    assert names(certificate(c, fast, 1.2)) == ["start-energy", "barrier-height"]


def test_a_low_barrier_has_its_own_name():
    moving = REST + np.array([0.03, 0.0])
    whole = starting(MASS, START, moving, NOWHERE, NOWHERE)
    c = table(weight=0.284, height=0.05)
    assert energy(c, whole, c.formation.first) < least_spring_energy(c)
    assert names(certificate(c, whole, 1.2)) == ["barrier-height"]


def test_an_edge_that_starts_outside_the_potential_is_named():
    far = START + np.array([[-0.7, 0.0], [0.0, 0.0], [0.0, 0.0]])
    concerns = certificate(table(), starting(MASS, far, REST, NOWHERE, NOWHERE), 1.2)
    assert concerns[0].name == "edge-outside-potential"
    assert "between 0 and 1 starts 1.903 m long" in concerns[0].text


def test_a_limit_that_the_jets_cannot_push_is_named():
    whole = starting(MASS, START, REST, NOWHERE, NOWHERE)
    assert names(certificate(table(), whole, max_force=1.0)) == ["limit-beyond-thrust"]


def test_obstacles_near_the_start_count():
    c = table(obstacle_band=0.45)
    whole = starting(MASS, START, REST, NOWHERE, NOWHERE)
    rock = Discs(np.array([[0.0, -0.8]]), np.zeros((1, 2)), np.array([0.5]))
    without = energy(c, whole, c.formation.first)
    wall, x, d = BoundedPotential(0.7, 1.8, 0.2), 0.8, 0.95
    bottom = (x - wall.near) + (d - wall.near) ** 2 * (wall.far - x) / wall.height
    expected = 0.284 * (x - d) ** 2 * (wall.far - x) / bottom
    assert energy(c, whole, c.formation.first, rock) - without == pytest.approx(expected)


def test_printed_parameters_of_xue2022_do_not_meet_their_own_lemma():
    # P Q = 20 J; the spring holds 0.4 J at epsilon/2 = 2 m
    shape = FormationParams(
        range=40.0, safe=10.0, far_margin=4.0, near_margin=4.0,
        distances={"a-b": 30.0, "b-c": 30.0, "a-c": 50.0},
    )  # fmt: skip
    proxy = ProxyParams(spring=0.2, limit=0.4, weight=0.002, height=1e4)
    c = coupling(proxy, shape, NAMES, led=False)
    assert least_spring_energy(c) == pytest.approx(0.4)
    assert c.weight * c.potential.height == pytest.approx(20.0)


def test_theorem_2_asks_for_the_heaviest_satellite():
    # xue2024, 4.2: holds up to 12.27 kg
    led = {"a-b": 40.0, "b-c": 40.0, "a-c": 80.0, "c-leader": 40.0}
    shape = FormationParams(range=50.0, safe=10.0, distances=led)
    c = coupling(ProxyParams(spring=0.3, limit=0.9, weight=0.04, height=1e4), shape, NAMES, True)
    accel = 0.1 * np.pi / 50.0

    def found(mass):
        return names(sgn_certificate(c, 0.1, 0.3, 0.0, np.array([10.0, 10.0, mass]), accel))

    assert found(12.26) == ["lock-in"]
    assert found(12.28) == ["beta-too-small", "lock-in"]
    slow = sgn_certificate(c, 0.02, 0.3, 0.01, np.full(3, 10.0), accel)
    assert names(slow) == ["alpha-too-small", "boundary-layer"]
