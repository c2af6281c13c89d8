"""Words and numbers of report.html."""

import re

import pytest

from testbed.config import find, load
from testbed.metrics.run_metrics import Metrics, VehicleMetrics
from testbed.report.page import _number, _pose, _results, _three_digits, _tiles, rounded

MINUS, JOINT = "\N{MINUS SIGN}", "\N{NO-BREAK SPACE}"


@pytest.mark.parametrize(
    ("value", "digits", "shown"),
    [(0.264, 2, "0.26"), (44.294, 2, "44.29"), (237.94, 2, "237.9"), (2432.73, 2, "2433"),
     (71.26, 1, "71.3"), (0.0291, 3, "0.029"), (1298.0, 0, "1298"), (-2432.73, 2, "-2433"),
     (0.0, 2, "0.00")],
)  # fmt: skip
def test_a_large_number_has_no_more_digits_than_it_is_worth(value, digits, shown):
    assert rounded(value, digits) == shown


def test_a_number_never_has_a_power_of_ten():
    assert [_three_digits(v) for v in (0.2184, 71.26, 2432.7)] == ["0.218", "71.3", "2433"]


def test_zero_has_no_minus():
    assert _number(-1e-9, 1.0, 2) == "0.00"
    assert _number(-0.01, 1.0, 2) == f"{MINUS}0.01"
    assert _pose((-1e-9, -2.2, -1e-9)) == f"(0.00, {MINUS}2.20){JOINT}m, 0\N{DEGREE SIGN}"


def tiles(name: str, *settled: float | None) -> dict[str, str]:
    """The tiles of a flight of an experiment, by their names."""
    scenario = load(find(name))
    near = 0.9 if scenario.obstacles else None
    metrics = Metrics(
        experiment=name, rig="twin", seed=0, completed=True, duration_s=150.0, wall_s=2.0,
        real_time_factor=75.0, contacts=0, fault=None, criteria={},
        min_vehicle_distance_m=1.2 if len(settled) > 1 else None,
        vehicles={
            f"sat{k}": VehicleMetrics(0.001, s, 0.001, 0.0005, 0.02, near, 6.0, 18.0, 800, 1.5)
            for k, s in enumerate(settled, 1)
        },
    )  # fmt: skip
    assert ("nearest obstacle" in _results(scenario, metrics)) == bool(scenario.obstacles)
    found = re.findall(r"<b>(.*?)</b><span>(.*?)</span>", _tiles(scenario, metrics))
    return {name: value.strip() for value, name in found}


def test_a_tile_is_left_out_where_there_is_nothing_to_be_near():
    assert [name for name in tiles("hold", 8.7) if name.startswith("nearest")] == []
    several = tiles("zhang2023_table", 70.0, 71.0, 72.0)
    assert several["nearest obstacle, centres"] == "0.90 m"
    assert several["nearest vehicles, centres"] == "1.20 m"


def test_the_tile_does_not_leave_out_a_vehicle_that_never_settled():
    assert tiles("zhang2023_table", 70.0, 71.0, 72.0)["settled, last vehicle"] == "72.0 s"
    some = tiles("zhang2023_table", 70.0, None, 72.0)
    assert some["vehicles settled"] == "2 of 3"
    assert "settled, last vehicle" not in some
