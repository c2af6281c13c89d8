"""Balances that hold whatever the details: momentum, angular momentum, energy."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from testbed.core.table import Obstacle

CRISP = {"open_delay_s": 0.0, "close_delay_s": 0.0, "open_ramp_s": 0.0, "close_ramp_s": 0.0}
OFF_CENTRE = (0.03, -0.02)  # [m]


def momenta(vehicles, states):
    """Momentum x, y, angular momentum about the table's origin, and kinetic energy; no gas used."""
    total = np.zeros(4)
    for vehicle, (x, y, theta, vx, vy, omega) in zip(vehicles, states, strict=True):
        c, s, (cx, cy) = np.cos(theta), np.sin(theta), vehicle.com
        rx, ry = c * cx - s * cy, s * cx + c * cy
        ux, uy, m = vx - omega * ry, vy + omega * rx, vehicle.mass
        total += [
            m * ux,
            m * uy,
            m * ((x + rx) * uy - (y + ry) * ux) + vehicle.inertia * omega,
            0.5 * m * (ux**2 + uy**2) + 0.5 * vehicle.inertia * omega**2,
        ]
    return total


def coasting(vehicle, x, y, theta, ux, uy, omega):
    """The state in which the centre of mass moves with (ux, uy): the origin wobbles round it."""
    c, s, (cx, cy) = np.cos(theta), np.sin(theta), vehicle.com
    return [x, y, theta, ux + omega * (s * cx + c * cy), uy - omega * (c * cx - s * cy), omega]


# Jets


def test_a_pulse_gives_its_impulse(make_vehicle, make_plant, make_plan):
    vehicle = make_vehicle(command_delay_s=0.0)
    plant = make_plant([vehicle], [[0.0] * 6])
    plant.boards["0"].apply(make_plan(0.0, {0: (0.02, 0.05), 1: (0.02, 0.05)}))
    plant.advance(0.2)
    open_for = 0.05  # opening and closing take equally long
    impulse = 2 * 0.6 * open_for / (1.0 + vehicle.air.droop)
    assert plant.impulse[0] == pytest.approx(impulse, rel=1e-12)
    assert_allclose(plant.x[0, 3:], [-impulse / vehicle.mass, 0.0, 0.0], atol=1e-14)


def test_a_steady_push_on_a_turning_body(make_vehicle, make_plant, make_plan):
    turn_rate, thrust, on = 3.0, 2 * 0.6, 0.08
    vehicle = make_vehicle(command_delay_s=0.0, valve=CRISP, air={"droop": 0.0})
    plant = make_plant([vehicle], [[0.0, 0.0, 0.4, 0.0, 0.0, turn_rate]])
    plant.boards["0"].apply(make_plan(0.0, {4: (0.0, on), 5: (0.0, on)}))
    plant.advance(0.1)
    angle = np.array([0.4, 0.4 + turn_rate * on])
    speed = thrust / vehicle.mass / turn_rate
    gained = [speed * np.diff(np.sin(angle))[0], -speed * np.diff(np.cos(angle))[0]]
    assert_allclose(plant.x[0, 3:5], gained, atol=1e-14)


def test_a_couple_changes_angular_momentum_and_nothing_else(make_vehicle, make_plant, make_plan):
    vehicle = make_vehicle(command_delay_s=0.0, com=OFF_CENTRE)
    start = [[0.7, -0.4, 0.3, 0.2, -0.1, 1.5]]
    plant = make_plant([vehicle], start)
    plant.boards["0"].apply(make_plan(0.0, {0: (0.01, 0.06), 4: (0.01, 0.06)}))
    plant.advance(0.2)
    torque_impulse = 2 * 0.6 * 0.09 * 0.06 / (1.0 + vehicle.air.droop)
    gained = momenta([vehicle], plant.x) - momenta([vehicle], start)
    assert_allclose(gained[:3], [0.0, 0.0, torque_impulse], atol=1e-14)


def test_an_unbalanced_body_that_coasts_keeps_its_momenta(make_vehicle, make_plant):
    vehicle = make_vehicle(com=OFF_CENTRE)
    start = [coasting(vehicle, -1.5, -0.4, 0.3, 0.05, 0.04, 6.0)]
    plant = make_plant([vehicle], start)
    plant.advance(30.0)
    assert_allclose(momenta([vehicle], plant.x), momenta([vehicle], start), atol=1e-12)


def test_the_rocket_equation(make_vehicle, make_plant, make_plan):
    speed = 600.0
    vehicle = make_vehicle(air={"exhaust_speed": speed})
    plant = make_plant([vehicle], [[0.0] * 6])
    for k in range(20):
        plant.boards["0"].apply(make_plan(0.1 * k, {2: (0.0, 0.1), 3: (0.0, 0.1)}))
        plant.advance(0.1 * (k + 1))
    gained = speed * np.log(vehicle.mass / (vehicle.mass - plant.used[0]))
    assert gained > 0.15
    assert_allclose(plant.x[0, 3:], [0.0, gained, 0.0], atol=1e-12)


# Touches


def before_and_after(make_plant, vehicles, states, table, obstacles=None):
    """The first touch, and the states a nanosecond to either side of it."""
    plant = make_plant(vehicles, states, table, obstacles)
    plant.advance(5.0)
    touch = plant.touches[0]
    plant = make_plant(vehicles, states, table, obstacles)
    return touch, plant.advance(5.0, [touch.t - 1e-9, touch.t + 1e-9])


ANGLE = st.floats(-3.0, 3.0)
SPIN = st.floats(-4.0, 4.0)
ARM = st.floats(-0.04, 0.04)
RESTITUTION = st.sampled_from((0.0, 1.0)) | st.floats(0.0, 1.0)


@settings(deadline=None, max_examples=150)
@given(
    restitution=RESTITUTION,
    mass=st.floats(3.0, 30.0),
    com=st.tuples(ARM, ARM),
    aim=st.floats(-0.2, 0.2),
    speed=st.floats(0.1, 0.5),
    angles=st.tuples(ANGLE, ANGLE),
    spins=st.tuples(SPIN, SPIN),
)
def test_two_vehicles_collide(
    make_vehicle, make_table, make_plant, restitution, mass, com, aim, speed, angles, spins
):
    vehicles = [make_vehicle(com=com), make_vehicle(mass=mass, com=(-0.01, 0.02))]
    states = [
        coasting(vehicles[0], -0.6, aim, angles[0], speed, 0.0, spins[0]),
        coasting(vehicles[1], 0.3, 0.0, angles[1], -0.1, 0.0, spins[1]),
    ]
    table = make_table(restitution=restitution)
    touch, (before, after) = before_and_after(make_plant, vehicles, states, table)
    assert touch.other in {"0", "1"}

    was, became = momenta(vehicles, before), momenta(vehicles, after)
    assert_allclose(became[:3], was[:3], atol=1e-11)
    assert became[3] <= was[3] + 1e-11
    if restitution == 1.0:
        assert became[3] == pytest.approx(was[3], abs=1e-7)

    normal = (before[1, :2] - before[0, :2]) / np.linalg.norm(before[1, :2] - before[0, :2])
    closing = (before[0, 3:5] - before[1, 3:5]) @ normal
    opening = (after[1, 3:5] - after[0, 3:5]) @ normal
    bounce = restitution if closing > 1e-3 else 0.0
    assert closing == pytest.approx(touch.speed, abs=1e-7)
    assert opening == pytest.approx(bounce * closing, abs=1e-7)


@pytest.mark.parametrize("restitution", [0.0, 0.4, 1.0])
@pytest.mark.parametrize(
    ("edge", "velocity", "normal"),
    [
        ("right edge", (0.4, 0.1), (1, 0)),
        ("left edge", (-0.4, 0.1), (-1, 0)),
        ("upper edge", (0.1, 0.4), (0, 1)),
        ("lower edge", (0.1, -0.4), (0, -1)),
    ],
)
@pytest.mark.parametrize("com", [(0.0, 0.0), OFF_CENTRE])
def test_an_edge_reverses_the_normal_velocity(
    make_vehicle, make_table, make_plant, restitution, edge, velocity, normal, com
):
    vehicle = make_vehicle(com=com)
    normal = np.array(normal)
    start = [*(2.0 * normal), 0.4, *velocity, 0.7]
    touch, (before, after) = before_and_after(
        make_plant, [vehicle], [start], make_table(restitution=restitution)
    )
    assert touch.other == edge
    assert before[0, :2] @ normal == pytest.approx(3.0 - vehicle.radius, abs=1e-8)
    assert after[0, 3:5] @ normal == pytest.approx(-restitution * before[0, 3:5] @ normal, abs=1e-7)
    was, became = momenta([vehicle], before), momenta([vehicle], after)
    along = np.array([-normal[1], normal[0]])
    assert became[:2] @ along == pytest.approx(was[:2] @ along, abs=1e-12)  # no friction
    assert became[3] <= was[3] + 1e-9
    if restitution == 1.0:
        assert became[3] == pytest.approx(was[3], abs=1e-7)


@pytest.mark.parametrize("restitution", [0.0, 0.4, 1.0])
@pytest.mark.parametrize("drift", [(0.0, 0.0), (-0.15, 0.05)])
def test_an_obstacle_reverses_the_relative_normal_velocity(
    make_vehicle, make_table, make_plant, restitution, drift
):
    vehicle = make_vehicle(com=OFF_CENTRE)
    rock = Obstacle(position=(1.0, 0.1), radius=0.5, solid=0.3, velocity=drift)
    touch, (before, after) = before_and_after(
        make_plant,
        [vehicle],
        [[0.0, 0.0, 0.4, 0.3, 0.0, 0.7]],
        make_table(restitution=restitution),
        {"rock": rock},
    )
    assert touch.other == "rock"
    centre = np.array(rock.position) + touch.t * np.array(drift)
    normal = before[0, :2] - centre
    assert np.linalg.norm(normal) == pytest.approx(0.3 + vehicle.radius, abs=1e-8)
    normal /= np.linalg.norm(normal)
    towards = (before[0, 3:5] - drift) @ normal
    assert (after[0, 3:5] - drift) @ normal == pytest.approx(-restitution * towards, abs=1e-7)
    # seen from the rock, which nothing moves, energy does not grow
    was, became = (momenta([vehicle], state - [0, 0, 0, *drift, 0]) for state in (before, after))
    assert became[3] <= was[3] + 1e-9


def test_energy_never_grows_in_a_crowd(make_vehicle, make_table, make_plant):
    rng = np.random.default_rng(7)
    vehicles = [make_vehicle(com=tuple(rng.uniform(-0.02, 0.02, 2))) for _ in range(5)]
    states = np.zeros((5, 6))
    states[:, :2] = [(-0.6, -0.5), (0.6, -0.5), (0.0, 0.0), (-0.6, 0.5), (0.6, 0.5)]
    states[:, 2:] = rng.uniform(-0.5, 0.5, (5, 4))
    table = make_table(size=(2.0, 2.0), restitution=0.9)
    plant = make_plant(vehicles, states, table)
    seen = plant.advance(20.0, np.arange(0.01, 20.0, 0.01))
    energy = np.array([momenta(vehicles, states)[3] for states in seen])
    assert len(plant.touches) > 20
    assert np.diff(energy).max() < 1e-12
    assert energy[-1] < 0.5 * energy[0]
