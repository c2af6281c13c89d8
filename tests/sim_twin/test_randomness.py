"""Streams of chance: one seed, many parts, no crosstalk."""

import numpy as np
import pytest

from sim_twin.plant_parameters import sample_plant
from sim_twin.randomness import exponential, normal, stream, uniform, words
from testbed.core.compiled import compiled
from testbed.core.jets import effect_matrix


def test_a_stream_is_known_by_seed_and_name():
    def draws(*key):
        return stream(*key).random(4).tolist()

    assert draws(1, "sat1", "camera") == draws(1, "sat1", "camera")
    others = [(2, "sat1", "camera"), (1, "sat2", "camera"), (1, "sat1", "metal"), (1, "sat1")]
    assert all(draws(*other) != draws(1, "sat1", "camera") for other in others)


def test_streams_are_not_correlated():
    parts = [stream(1, name, part) for name in ("a", "b", "c") for part in ("camera", "metal")]
    draws = np.array([part.standard_normal(20_000) for part in parts])
    assert np.abs(np.corrcoef(draws) - np.eye(len(parts))).max() < 0.03


def test_a_vehicle_without_tolerances_is_forged_as_drawn(make_vehicle):
    vehicle = make_vehicle(com=(0.01, 0.02))
    parameters = sample_plant({"a": vehicle}, 1)
    assert parameters.effect[0] == pytest.approx(effect_matrix(vehicle.jets), abs=1e-15)
    assert parameters.thrust[0] == pytest.approx(0.6)
    assert (parameters.mass[0], parameters.inertia[0]) == (vehicle.mass, vehicle.inertia)
    assert tuple(parameters.com[0]) == vehicle.com


def test_what_is_forged_spreads_by_the_tolerances(shipped_vehicle):
    fleet = {str(k): shipped_vehicle for k in range(1000)}
    spread, parameters = shipped_vehicle.tolerance, sample_plant(fleet, 1)
    assert parameters.mass.mean() == pytest.approx(shipped_vehicle.mass, rel=0.002)
    assert parameters.mass.std() == pytest.approx(shipped_vehicle.mass * spread.mass, rel=0.1)
    assert parameters.inertia.std() == pytest.approx(
        shipped_vehicle.inertia * spread.inertia, rel=0.1
    )
    assert parameters.com.std() == pytest.approx(spread.com, rel=0.1)
    assert parameters.thrust.std() == pytest.approx(0.6 * spread.thrust, rel=0.05)
    push = np.hypot(parameters.effect[:, 0], parameters.effect[:, 1])
    assert push == pytest.approx(parameters.thrust)
    sideways = parameters.effect[:, 1, :2] / push[:, :2]  # of two jets that should push along -x
    assert np.degrees(sideways.std()) == pytest.approx(spread.direction_deg, rel=0.1)


def test_one_vehicle_more_changes_no_other(shipped_vehicle):
    few = sample_plant({"a": shipped_vehicle, "b": shipped_vehicle}, 1)
    many = sample_plant({"c": shipped_vehicle, "a": shipped_vehicle, "b": shipped_vehicle}, 1)
    for before, after in zip(few, many, strict=True):
        assert (before == after[1:]).all()


@compiled
def fill(own, kind, found):
    for i in range(found.shape[0]):
        found[i] = uniform(own) if kind == 0 else normal(own) if kind == 1 else exponential(own)


@pytest.mark.parametrize("kind", range(3))
def test_compiled_code_draws_what_numpy_draws_bit_for_bit(kind):
    generator = stream(kind, "a")
    own, found = words(generator), np.empty(1_000_000)
    fill(own, kind, found)
    draw = (generator.random, generator.standard_normal, generator.standard_exponential)[kind]
    assert (found == draw(len(found))).all()
    assert (own == words(generator)).all()


def test_a_copy_of_a_stream_draws_the_same_again():
    own = words(stream(1, "a"))
    again = own.copy()
    assert [normal(own) for _ in range(50)] == [normal(again) for _ in range(50)]
