"""Numbers of a run apply to the goal that the vehicle had."""

import math
import re

import numpy as np
import pytest

import testbed
from testbed.campaign.evidence import read_run
from testbed.campaign.row import columns_of, outcome_of
from testbed.config.shipped import SHIPPED
from testbed.run.report import write_page

OF_A_RESTING_GOAL = ("settle_s", "hold_rms_m")


@pytest.fixture(scope="module")
def along(tmp_path_factory):
    """A vehicle that follows a goal over two metres; what it has no number for is asked, too."""
    asked = [f"criteria.{key}=99" for key in (*OF_A_RESTING_GOAL, "final_error_m")]
    path = testbed.load(SHIPPED / "scenarios/path.toml", "duration_s=35", *asked)
    return testbed.fly(path, log=tmp_path_factory.mktemp("flown") / "a")


def test_the_final_error_is_to_where_the_goal_is_at_the_end(along):
    setup, flown = along.experiment.vehicles["sat1"], along.metrics.vehicles["sat1"]
    state = along["sat1"].pose[-1]
    goal = np.add(setup.path.at(35.0).p, setup.goal[:2])
    assert math.dist(goal, setup.goal[:2]) > 2.0
    assert flown.final_error_m == pytest.approx(math.dist(state[:2], goal), abs=0.02)
    assert along.metrics.criteria["final_error_m"] is True


def test_a_goal_that_moves_is_never_reached_nor_held(along):
    flown, experiment = along.metrics.vehicles["sat1"], along.experiment
    assert [getattr(flown, key) for key in OF_A_RESTING_GOAL] == [None, None]
    words = ", ".join(f"{key} (nothing was measured)" for key in OF_A_RESTING_GOAL)
    assert outcome_of(experiment, along.metrics) == ("failed", words)
    columns = columns_of(along.metrics, experiment, {})
    assert [columns[key] for key in OF_A_RESTING_GOAL] == [None, None]


def test_its_page_has_no_number_for_them(along):
    write_page(along.folder, along.experiment, print)
    page = (along.folder / "report.html").read_text()
    (row,) = [row for row in page.split("<tr>") if " 99 s</td>" in row]
    assert re.findall(r"<td[^>]*>([^<]*)</td>", row)[-1] == "\N{EN DASH}"


def test_a_vehicle_of_a_formation_has_no_error_to_a_goal(tmp_path):
    flown = testbed.fly(testbed.load("xue2022_table", "duration_s=2", "criteria={}")).metrics
    for one in flown.vehicles.values():
        assert (one.final_error_m, one.settle_s, one.hold_rms_m) == (None, None, None)


def test_a_run_that_is_read_has_its_fault(tmp_path):
    """So that equal faults are counted as one reason, as with runs of a campaign."""
    asked = ["duration_s=20", "criteria={}", "flight.gate.max_speed=0.001"]
    folder = testbed.fly(
        testbed.load(SHIPPED / "scenarios/step.toml", *asked, seed=4), log=tmp_path / "a"
    ).folder
    run = read_run(folder, 0, {}, {})
    assert run.outcome == "fault"
    assert run.fault is not None
    assert run.fault.vehicle == "sat1"
    assert run.seed == 4
    assert run.fault_t is not None
