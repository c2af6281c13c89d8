"""The board's limits as they follow from a vehicle file."""

from msgspec.structs import replace

from firmware_interface.limits import limits_of
from testbed.config import find, load
from testbed.core.vehicle import Gauges


def test_the_vehicle_file_sets_the_voltage_below_which_the_board_shuts_its_valves():
    model = load(find("hold")).vehicles["sat1"].model
    assert limits_of(model).undervoltage_mv == 8_000
    low = replace(model, gauges=Gauges(undervoltage_v=9.5))
    assert limits_of(low).undervoltage_mv == 9_500
    assert limits_of(replace(model, gauges=Gauges())).undervoltage_mv == 0
