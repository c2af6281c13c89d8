"""Whole commissionings on the twin; benchmarks/commission.py plants all errors on all vehicles."""

import sys
from pathlib import Path

import pytest
from msgspec.structs import replace

from testbed.commission.pace import FASTEST, LONGEST, PUSH, pulse_length
from testbed.commission.procedure import commission
from testbed.commission.report import measured, passed
from testbed.commission.twin_station import TwinStation
from testbed.core.fault_injection import Injection
from testbed.identification.vehicle_file import load_vehicle

sys.path.insert(0, str(Path(__file__).parents[2] / "benchmarks"))
from commission import ERRORS, Planted, fly, setup


def test_a_healthy_vehicle_passes_and_is_measured():
    experiment = setup("generic_8jet", 3)
    station = Planted(experiment, None, {})
    done = commission(experiment, station)
    assert not [v.text for v in done.verdicts if v.code or v.skipped]
    assert passed(done.verdicts, "sat1")
    vehicle, notes = measured(experiment.vehicles["sat1"].model, done.pulses["sat1"])
    station.bearing("sat1", on=True)  # without air it has no thrust
    true = station.twin.plant.parameters.thrust[0] / station.twin.plant.parameters.mass[0]
    found = [jet.thrust / vehicle.mass for jet in vehicle.jets]
    assert found == pytest.approx(true.tolist(), rel=0.08)
    assert "jets.0" in notes


@pytest.mark.parametrize(
    "name",
    [
        "wires of opposite jets 1 and 6 exchanged", "body registered 90 deg off", "mm for m",
        "frame of the cameras mirrored", "bodies of two vehicles exchanged",
        "boards of two vehicles exchanged", "firmware of another vehicle",
        "vehicle file of a lighter vehicle", "a valve is stuck open", "a valve leaks a fifth",
        "a valve's wire is off", "a hose pulls", "air is shut",
    ],
)  # fmt: skip
def test_a_planted_error_is_named_while_everything_is_slow(name):
    how, codes = ERRORS[name]
    found, speed, words = fly(setup("generic_8jet", 5, two=how.get("two", False)), how)
    assert found & codes, words
    assert speed < FASTEST


@pytest.mark.parametrize(
    ("what", "code"),
    [
        ({"kind": "reverse_jet", "jet": 3}, "jet_reversed"),
        ({"kind": "swap_jets", "jet": 2, "value": 5.0}, "wires_swapped"),
        ({"kind": "leak_valve", "jet": 5, "value": 0.2}, "leak"),
        ({"kind": "stick_closed", "jet": 7}, "dead"),
        ({"kind": "turn_frame"}, "frame_turned"),
        ({"kind": "swap_boards", "other": "sat2"}, "boards_swapped"),
        ({"kind": "swap_bodies", "other": "sat2"}, "bodies_swapped"),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_a_fault_that_the_experiment_injects_is_named(what, code):
    healthy = setup("generic_8jet", 5, two="other" in what)
    experiment = replace(healthy, inject=[Injection(vehicle="sat1", at_s=0.0, **what)])
    done = commission(experiment, TwinStation(experiment))
    assert code in {v.code for v in done.verdicts}, [v.text for v in done.verdicts if v.code]


@pytest.mark.parametrize("name", ["generic_8jet", "uky", "ita", "spot_red"])
def test_pulses_are_as_long_as_the_vehicle_needs(name):
    vehicle = load_vehicle(name)
    for jet, one in enumerate(vehicle.jets):
        length = pulse_length(vehicle, jet, PUSH)
        assert vehicle.valve.min_on_s <= length <= LONGEST
        assert one.thrust * length / vehicle.mass < 0.5 * FASTEST
        assert pulse_length(vehicle, jet, PUSH, 3.0) <= length
