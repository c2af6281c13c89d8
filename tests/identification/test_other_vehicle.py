"""A log of another vehicle is named, and a healthy one is not."""

import numpy as np
import pytest
from msgspec import structs

from testbed.identification import moved_jets
from testbed.identification.estimate import Estimate
from testbed.identification.jets import JetFinding
from testbed.identification.model import VehicleModel
from testbed.identification.motion import RefusedError, calibrate_motion, doubts_about
from testbed.identification.suspicion import suspicions
from testbed.identification.synthetic import excitation, flown_log
from testbed.identification.vehicle_file import load_vehicle
from testbed.identification.windows import tiled


def flown(vehicle, seed=5, seconds=40.0):
    rng = np.random.default_rng(seed)
    inputs = excitation(vehicle, seconds, 0.1, rng)
    return flown_log(vehicle, None, inputs, seconds, rng)


def refused(logs, vehicle, **others):
    with pytest.raises(RefusedError) as caught:
        calibrate_motion(logs, vehicle, **others)
    return [(one.name, one.text) for one in caught.value.suspicions]


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("uky", "23.09 kg and jets at other places"),
        ("spot_black", "flown with jets at other places"),
    ],
)
def test_a_log_that_tells_its_vehicle_is_compared_with_the_file(flight, floater, name, words):
    log = flight[1]._replace(vehicle=floater)
    found = list(suspicions([log], load_vehicle(name)))
    assert [one.name for one in found] == ["other-vehicle"]
    assert words in found[0].text
    recalibrated = structs.replace(floater, mass=1.02 * floater.mass)
    assert list(suspicions([log], recalibrated)) == []


@pytest.fixture(scope="module")
def red():
    """As it flies: with a droop that its file does not state."""
    red = load_vehicle("spot_red")
    return structs.replace(red, air=structs.replace(red.air, droop=0.3))


@pytest.mark.parametrize(("factor", "word"), [(1.6, "lighter"), (1.4, "lighter"), (0.6, "heavier")])
def test_another_ratio_of_thrust_to_mass_is_named(floater, factor, word):
    other = structs.replace(floater, mass=factor * floater.mass, inertia=factor * floater.inertia)
    (name, text), *_ = refused([flown(floater)], other)
    assert name == "other-vehicle"
    assert word in text


def test_the_levers_of_another_vehicle_of_the_lab_are_named(red):
    black = load_vehicle("spot_black")
    same = structs.replace(black, mass=red.mass)  # thrust over mass tells nothing
    log = flown(red)
    found = refused([log], same, others={"spot_red": red, "spot_black": same})
    assert [name for name, _ in found] == ["other-vehicle"]
    assert "levers of spot_red" in found[0][1]
    healthy = calibrate_motion([log], red, others={"spot_red": red, "spot_black": same})
    assert healthy.suspicions == []


def test_a_rather_heavy_vehicle_is_named_and_fitted(floater):
    """A supply that is set low looks the same, so it is no reason to refuse."""
    heavier = structs.replace(floater, mass=1.25 * floater.mass, inertia=1.25 * floater.inertia)
    (found,) = calibrate_motion([flown(heavier)], floater).suspicions
    assert found.name == "other-vehicle"
    assert "heavier, or little supply" in found.text


@pytest.mark.parametrize("jet", [2, 7])
def test_a_jet_that_was_moved_is_named(floater, jet):
    jets = list(floater.jets)
    (x, y), (px, py) = jets[jet].position, jets[jet].push
    jets[jet] = structs.replace(jets[jet], position=(x - 0.03 * py, y + 0.03 * px))
    moved = structs.replace(floater, jets=jets)
    (name, text), *_ = refused([flown(moved)], floater)
    assert name == "other-vehicle"
    assert text.startswith(f"jet {jet + 1} pushes")


@pytest.mark.parametrize(("sigma", "named"), [(0.02, True), (0.087, True), (0.113, False)])
def test_a_lever_whose_interval_has_the_place_of_the_file_in_it_is_no_suspicion(
    floater, flight, monkeypatch, sigma, named
):
    """A healthy log of one path may leave a lever so unknown that it is 1.6 sigma beside."""
    model = VehicleModel(floater, valves=True)
    windows = tiled(flight[1], 2.5)
    wide = Estimate(model.prior, np.arange(0), model.sigma, *[np.zeros((1, 1))] * 4)

    def fitted(free, windows, groups, start):
        p, beside = free.prior.copy(), free.index("lever_4")
        p[beside] = 0.178
        return wide._replace(p=p, sigma=np.where(np.arange(len(p)) == beside, sigma, 1.0))

    monkeypatch.setattr(moved_jets, "fit", fitted)
    monkeypatch.setattr(moved_jets, "folds", lambda *args: [])
    error = {True: np.full(6, 0.2), False: np.ones(6)}  # of unseen parts, with the lever or not
    monkeypatch.setattr(moved_jets, "unseen", lambda *args: error["lever_4" in args[3]])
    jets = [JetFinding(k, "ok", 1.0, 0.01) for k in range(8)]
    found = list(moved_jets.by_moved_jets(model, jets, wide, [windows]))
    assert [one.text.split(":")[0] for one in found] == [
        f"jet 4 pushes 178 mm (+- {1.96e3 * sigma:.0f}) beside its place in the file"
    ] * named


def test_a_log_that_is_too_short_to_tell_its_vehicle_says_so(red):
    others = {"spot_red": red, "spot_black": load_vehicle("spot_black")}
    found = calibrate_motion([flown(red, seconds=10.0)], red, others=others)
    assert [(one.name, one.refuses) for one in found.suspicions] == [("vehicle-ambiguous", False)]
    assert "spot_black" in found.suspicions[0].text


def test_a_validation_looks_for_another_vehicle(floater):
    lighter = structs.replace(floater, mass=0.7 * floater.mass, inertia=0.7 * floater.inertia)
    assert [one.name for one in doubts_about([flown(lighter)], floater, {})] == ["other-vehicle"]
    assert doubts_about([flown(floater)], floater, {}) == []


def test_a_log_of_a_rebuilt_vehicle_among_others_is_named(red):
    rebuilt = structs.replace(red, mass=0.6 * red.mass, inertia=0.6 * red.inertia)
    odd = flown(rebuilt, 7, 20.0)._replace(where="rebuilt")
    found = refused([flown(red, 5, 30.0), flown(red, 6, 30.0), odd], red)
    assert any(text.startswith("rebuilt: thrust over mass") for _, text in found)
