"""Mass and thrust that follow the gas, and the thrust of each jet."""

import numpy as np
import pytest

from testbed.config import SHIPPED, load
from testbed.flight.effectiveness import resolve
from testbed.flight.fired import model_of
from testbed.flight.memory import make_memory
from testbed.flight.online import (
    OnlineParams,
    follow_jets,
    gains_now,
    gas_used,
    model_now,
    online_of,
)
from testbed.flight.tracker import TrackerParams, gains_of
from testbed.rig.observers import MetricsObserver
from testbed.rig.twin import make_twin
from testbed.run.judge import measure

SHUT = np.zeros(8)


def known(vehicle, **on):
    return online_of(OnlineParams(**on), vehicle)


def test_a_gauge_at_the_tank_tells_the_gas(vehicle):
    p, air = known(vehicle), vehicle.air
    assert gas_used(p, 0.0, air.tank_pressure, SHUT, 1.0, 0.1) == 0.0
    assert gas_used(p, 0.0, 0.25 * air.tank_pressure, SHUT, 1.0, 0.1) == 0.75 * air.gas
    assert gas_used(p, 0.1, 1.1 * air.tank_pressure, SHUT, 1.0, 0.1) == 0.0


def test_without_a_gauge_the_flow_is_added_up(vehicle):
    p, air = known(vehicle), vehicle.air
    flowed = np.array([1.0, 0.5, *np.zeros(6)])
    jets = (vehicle.jets[0].thrust + 0.5 * vehicle.jets[1].thrust) / air.exhaust_speed
    jets *= 0.8
    found = gas_used(p, 0.01, 0.0, flowed, 0.8, 0.1)
    assert found == pytest.approx(0.01 + 0.1 * (jets + air.bearing_flow))
    assert gas_used(p, air.gas, 0.0, flowed, 0.8, 0.1) == air.gas


def test_switched_off_the_numbers_are_the_files(vehicle):
    model, gains = model_of(vehicle), gains_of(TrackerParams(), vehicle, 0.1)
    p = known(vehicle)
    assert gains_now(p, gains, 0.2) == gains
    for one, other in zip(model_now(p, model, 0.2, 0.7), model, strict=True):
        np.testing.assert_array_equal(one, other)


def test_switched_on_mass_and_thrust_follow(vehicle):
    model, gains = model_of(vehicle), gains_of(TrackerParams(), vehicle, 0.1)
    p = known(vehicle, mass=True, thrust=True)
    assert gains_now(p, gains, 0.2).mass == vehicle.mass - 0.2
    now = model_now(p, model, 0.2, 0.8)
    assert now.mass == pytest.approx((vehicle.mass - 0.2) / 0.8)
    assert now.inertia == pytest.approx(vehicle.inertia / 0.8)


@pytest.fixture
def told():
    """Fired plans and what was evidence of eight jets that each give 0.9 of what is assumed."""
    memory, _ = make_memory(8, 2, 3, 1)
    rng = np.random.default_rng(3)
    z, slow = 10.0 * rng.standard_normal((300, 19)), memory.evidence.innovations.slow
    slow[:, :19], slow[:, 19] = z.T @ z, z.T @ (z[:, :8] @ np.full(8, -0.1))
    memory.evidence.off[:], memory.evidence.sigma[:] = -0.1, 0.01
    return memory.fired, memory.evidence


def followed(fired, evidence, seconds=100.0):
    for _ in range(round(seconds / 0.1)):
        follow_jets(fired, evidence, 0, 0.1)
        resolve(evidence.innovations.slow, np.full(19, 1e-9), evidence.off, evidence.sigma)


def test_the_assumed_thrust_of_a_jet_follows_what_the_motion_tells(told):
    fired, evidence = told
    followed(fired, evidence)
    np.testing.assert_allclose(fired.gives, 0.9, atol=0.02)
    np.testing.assert_allclose(1.0 + evidence.off, 0.9, atol=0.01)


def test_a_jet_that_leaks_or_was_taken_out_stays_as_it_was_found(told):
    fired, evidence = told
    fired.leaks[1], fired.gives[2] = 0.3, 0.0
    followed(fired, evidence, 1.0)
    assert fired.gives[1] == 1.0
    assert fired.gives[2] == 0.0
    assert fired.gives[3] < 1.0


def test_a_jet_that_is_probed_stays_as_it_was_found(told):
    fired, evidence = told
    fired.gives[4] = 0.7
    follow_jets(fired, evidence, 5, 0.1)
    assert fired.gives[4] == 0.7
    follow_jets(fired, evidence, 0, 0.1)
    assert fired.gives[4] > 0.7


def test_an_estimate_within_its_noise_moves_nothing(told):
    fired, evidence = told
    evidence.off[:], evidence.sigma[:] = 0.04, 0.05
    follow_jets(fired, evidence, 0, 0.1)
    np.testing.assert_array_equal(fired.gives, 1.0)


def flown(*switches):
    """Gas of the twin and of the chain, and the tracking error, with four fifths of it used."""
    experiment = load(SHIPPED / "scenarios" / "circle.toml", [
        "vehicles.sat1.model.air.gas=2.5", "duration_s=20", *switches,
        'vehicles.sat1.path={type="square", side=0.6, period_s=60}',
    ])  # fmt: skip
    rig, observer = make_twin(experiment), MetricsObserver(experiment.vehicles)
    rig.twin.plant.used[:] = 2.0
    ending = rig.fly(observer)
    metrics = measure(rig, observer.aims, ending, 0.0, completed=ending.fault is None)
    (node,) = rig.vehicles
    told = float(node._agent.memory.fixed[0]["gas_used"])
    return float(rig.twin.plant.used[0]), told, metrics.vehicles["sat1"].track_rms_m


def test_a_vehicle_that_has_lost_a_sixth_of_its_mass_tracks_better_when_it_knows():
    used, told, without = flown()
    assert told == pytest.approx(used, abs=1e-3)
    *_, with_it = flown("flight.online.mass=true")
    assert with_it < 0.7 * without
