"""The data behind a report's scrubber, and the bar with its events."""

import json
import re

import numpy as np
from msgspec.structs import replace

from testbed.config import find, load
from testbed.logs.history import History, VehicleHistory
from testbed.report.fault_story import EventLine
from testbed.report.scrubber import SAMPLES, bar, flight_data

SCENARIO = load(find("hold"))


def moving(t, on=None, edges=None) -> VehicleHistory:
    """A vehicle that turns and moves along x at 0.1 m/s."""
    n = len(t)
    pose = np.column_stack((0.1 * t, np.zeros(n), np.angle(np.exp(1j * t))))
    none = np.full((n, 3), np.nan)
    return VehicleHistory(
        t=t, at=t, pose=pose, twist=np.zeros((n, 3)), seen=np.zeros((0, 4)),
        reference=none, force_asked=none[:, :2],
        commanded_wrench=none, realised_wrench=none,
        on=np.zeros((n, 8)) if on is None else on, offset=np.zeros((n, 8)),
        supply=np.zeros(n), tank=np.zeros(n), pose_age=np.zeros(n), filtered=np.zeros((n, 2)),
        events=[], edges=np.zeros((0, 2)) if edges is None else edges, wires=np.zeros((0, 5)),
        true=np.zeros((0, 6)),
    )  # fmt: skip


def data_of(vehicle, events=()):
    return flight_data(SCENARIO, history({"sat1": vehicle}), events)


def history(vehicles):
    return History(vehicles, np.zeros(0), {}, np.zeros((0, 3)))


def test_poses_are_those_of_the_flight_also_where_the_heading_wraps():
    t = np.arange(0.0, 20.0, 0.1)
    found = data_of(moving(t))
    (car,) = found["vehicles"]
    at = found["step"] * np.arange(len(car["x"]))
    inside = at <= t[-1]
    assert np.abs(np.array(car["x"]) - 100.0 * at)[inside].max() <= 0.5  # [mm]
    assert np.abs(np.radians(np.array(car["turn"]) / 100) - at)[inside].max() < 1e-3
    assert len(car["on"]) == 8 * len(at)


def test_the_event_that_ends_a_flight_can_be_reached():
    after = EventLine(12.1, ("sat1",), "WARN", "stopped by the operator")
    found = data_of(moving(np.arange(0.0, 12.0, 0.1)), [after])
    assert found["events"][-1][0] <= found["end"]


def test_the_time_ends_with_the_plan_of_the_last_tick():
    assert data_of(moving(np.arange(0.0, 12.0, 0.1)))["end"] == 12.0


def test_a_jet_is_open_where_its_plan_or_its_board_says_so():
    t = np.arange(0.0, 10.0, 0.1)
    on = np.zeros((len(t), 8))
    on[30, 2] = 0.05
    delay = SCENARIO.vehicles["sat1"].model.command_delay_s
    planned = data_of(moving(t, on))["vehicles"][0]["on"]
    shares = np.array(list(planned), int).reshape(-1, 8)
    assert {int(jet) for jet in np.nonzero(shares)[1]} == {2}
    k = int((3.0 + delay) / 0.1 + 1e-6)
    assert shares[k : k + 2, 2].sum() in (5, 6)  # of nine, in one sample or in two
    edges = np.array([[5.02, 0b1000], [5.08, 0]])
    reported = data_of(moving(t, on, edges))["vehicles"][0]["on"]
    shares = np.array(list(reported), int).reshape(-1, 8)
    assert np.argwhere(shares).tolist() == [[50, 3]]


def test_a_long_flight_stays_small():
    t = np.arange(0.0, 3600.0, 0.1)
    found = data_of(moving(t))
    assert len(found["vehicles"][0]["x"]) <= SAMPLES + 2
    assert len(bar(found)) < 200_000


def test_the_page_opens_at_the_first_fault_and_events_are_buttons():
    t = np.arange(0.0, 10.0, 0.1)
    events = [EventLine(0.0, ("supervisor",), "INFO", "RUNNING: run"),
              EventLine(4.0, ("sat1",), "CRITICAL", "hit obstacle </script> o1, 11 cm/s"),
              EventLine(5.0, ("sat1",), "ERROR", "land")]  # fmt: skip
    found = data_of(moving(t), events)
    assert found["first"] == 4.0
    html = bar(found)
    assert re.findall(r'class="tick (\w+)" data-t="([\d.]+)"', html) == [
        ("CRITICAL", "4.0"), ("ERROR", "5.0"),
    ]  # fmt: skip
    text = html.partition('id="flight">')[2].partition("</script>")[0]
    assert json.loads(text)["events"][1][3].startswith("hit obstacle </script>")
    assert data_of(moving(t))["first"] == found["end"]  # else at the end


def test_an_obstacle_that_moves_is_moved():
    dynamic = load(find("xue2021_table_dynamic"))
    crew = dict.fromkeys(dynamic.vehicles, moving(np.arange(0.0, 3.0, 0.1)))
    found = flight_data(dynamic, history(crew))
    assert [one["velocity"] for one in found["obstacles"]] == [dynamic.obstacles["o1"].velocity]
    assert flight_data(replace(dynamic, obstacles={}), history(crew))["obstacles"] == []
