"""The board's limits as they follow from a vehicle file."""

import pytest
from msgspec.structs import replace

from firmware_interface.limits import LimitsError, config_hash, limits_of
from firmware_interface.messages import BearingPolicy, Config
from testbed.config import find, load
from testbed.core.vehicle import Gauges, Landing


def test_the_vehicle_file_sets_the_voltage_below_which_the_board_shuts_its_valves():
    model = load(find("hold")).vehicles["sat1"].model
    assert limits_of(model).undervoltage_mv == 8_000
    low = replace(model, gauges=Gauges(undervoltage_v=9.5))
    assert limits_of(low).undervoltage_mv == 9_500
    assert limits_of(replace(model, gauges=Gauges())).undervoltage_mv == 0


def test_the_vehicle_file_sets_when_the_board_lands():
    model = load(find("hold")).vehicles["sat1"].model
    assert limits_of(model).bearing_after_trip == BearingPolicy.DROP
    assert limits_of(model).land_after_us == 0
    slow = limits_of(replace(model, landing=Landing(speed=0.1, slope=0.0, friction=0.1)))
    # 5 cm at 0.1 m/s, less the watchdog's 0.15 s and the slide of 0.1^2 / (2 * 0.981) m
    assert slow.land_after_us == pytest.approx(350_000 - 51_000, abs=100)
    long = limits_of(replace(model, landing=Landing(speed=1e-4, slope=0.0)))
    assert long.land_after_us == Config.LIMITS["land_after_us"][1]
    never = limits_of(replace(model, landing=Landing(by_board=False)))
    assert never.bearing_after_trip == BearingPolicy.KEEP


def test_boards_of_vehicles_with_other_jets_are_told_apart():
    model = load(find("hold")).vehicles["sat1"].model
    known = config_hash(limits_of(model))
    first, second, *others = model.jets
    swapped = replace(model, jets=[second, first, *others])
    turned = replace(model, jets=[replace(first, push=(1.0, 0.0)), second, *others])
    moved = replace(model, jets=[replace(first, position=(0.151, 0.09)), second, *others])
    assert len({known, *(config_hash(limits_of(m)) for m in (swapped, turned, moved))}) == 4
    calibrated = replace(model, jets=[replace(first, thrust=0.5), second, *others])
    assert config_hash(limits_of(calibrated)) == known


def test_more_jets_than_the_board_has_outputs_are_refused_with_what_to_do():
    model = load(find("hold")).vehicles["sat1"].model
    with pytest.raises(LimitsError) as refused:
        limits_of(replace(model, jets=[*model.jets, model.jets[0]]))
    assert refused.value.expected == "1 to 8 jets"
    assert "the vehicle has 9 jets" in refused.value.found
    assert "only the twin flies it" in refused.value.hint
