"""Logs of three labs: figures that a fit must reach. Skipped where the data are not."""

import numpy as np
import pytest

from shared_data import shared
from testbed.identification.cameras import latency_of
from testbed.identification.columns import read_columns, read_sources
from testbed.identification.floor import flat_fit, learn_floor
from testbed.identification.mapping import load_mapping
from testbed.identification.motion import RefusedError, calibrate_motion
from testbed.identification.motion_log import read_motion_log
from testbed.identification.suspicion import suspicions
from testbed.identification.thrust_stand import thrust_of
from testbed.identification.validation import HORIZONS, errors_ahead
from testbed.identification.vehicle_file import load_vehicle
from testbed.identification.windows import ahead_of, sliding

STAND = (0.4415, 0.4307, 0.4277, 0.4380, 0.4689, 0.4468, 0.4670, 0.4841)  # [N]


def read(name, mapping):
    return read_motion_log(shared(name), load_mapping(mapping))


def rms(log, vehicle):
    return errors_ahead([log], vehicle, HORIZONS[1]).figures()["position_rms_m"]


def test_uky_jet_2_is_named_and_unseen_parts_are_predicted():
    log = read("uky/hardware_run_first_60_percent.csv", "uky")
    lab = load_vehicle("uky")
    early = log._replace(whole=log.t < 76.0)
    late = log._replace(whole=log.t >= 76.0)
    found = calibrate_motion([early], lab)
    assert [f.jet + 1 for f in found.jets if f.state == "dead"] == [2]
    assert rms(late, found.vehicle) < 0.40 * rms(late, lab)


@pytest.mark.parametrize("jet", range(1, 9))
def test_uky_stand(jet):
    columns = read_columns(shared(f"uky/thrust_stand_jet{jet}.csv"), ["t_s", "weight_g", "bitmask"])
    found = thrust_of(columns, "t_s", "weight_g", "g", "bitmask")
    assert found["thrust_n"] == pytest.approx(STAND[jet - 1], rel=0.01)


@pytest.mark.parametrize(
    ("name", "vehicle"),
    [("red_2021-03-06_1420_1", "spot_red"), ("black_2021-03-06_1613_1", "spot_black"),
     ("red_2021-03-06_1045_1", "spot_red")],
)  # fmt: skip
def test_spot_logs_are_not_suspected(name, vehicle):
    assert list(suspicions([read(f"spot/{name}.csv.gz", "spot")], load_vehicle(vehicle))) == []


@pytest.mark.parametrize("name", ["black_2021-02-27_1405_1", "black_2021-03-06_1613_1"])
def test_spot_the_log_of_black_is_not_fitted_as_red(name):
    others = {one: load_vehicle(one) for one in load_mapping("spot").vehicles}
    log = read(f"spot/{name}.csv.gz", "spot")
    with pytest.raises(RefusedError, match="other-vehicle"):
        calibrate_motion([log], others["spot_red"], others=others)


def test_spot_unseen_strong_pushes_are_predicted():
    lab, unseen = load_vehicle("spot_red"), "1420_1"
    seen = ("1045_1", "1118_2", "1322_3", "1533_2")
    log, *logs = (read(f"spot/red_2021-03-06_{n}.csv.gz", "spot") for n in (unseen, *seen))
    assert rms(log, calibrate_motion(logs, lab).vehicle) < 0.25 * rms(log, lab)


@pytest.mark.parametrize(
    ("factors", "named"), [((1, 1), []), ((1, -1), ["mirrored-y"]), ((-1, -1), ["signs-turned"])]
)
def test_ita_a_steep_table_is_no_mirrored_axis(factors, named):
    names = ("track_uncompensated_no_wheel", "disturbance")
    logs = [read(f"ita/dlqr_{name}.csv", "ita") for name in names]
    seen = [log._replace(pose=log.pose * [*factors, 1]) for log in logs]
    assert [one.name for one in suspicions(seen, load_vehicle("ita"))] == named


def test_ita_camera_latency():
    found = read_sources(shared("ita/camera_latency.csv"), "source", "t_s", "angle_deg")
    camera, servo = found["camera"], found["servo"]
    result = latency_of(servo[:, 0], servo[:, 1], camera[:, 0], camera[:, 1])
    assert result["latency_s"] == pytest.approx(0.051, abs=0.003)


def test_ita_a_learned_slope_map_predicts_a_log_that_it_has_not_seen():
    vehicle = load_vehicle("ita")
    names = ("track_uncompensated_no_wheel", "disturbance")
    seen = [read(f"ita/dlqr_{name}.csv", "ita") for name in names]
    other = read("ita/dlqr_track_compensated.csv", "ita")
    windows = sliding(other, 1.0, 3.0, 0.5)
    last = [len(rows) - 1 for rows in windows.rows]
    weight = np.array([1e3, 1e3, 3e2])

    def error(model, p):
        off = ahead_of(model, p, windows, 1.0, weight)[np.arange(len(last)), last]
        return float(np.sqrt(np.mean(np.sum(off[:, :2] ** 2, axis=1))))

    floor = learn_floor(seen, vehicle, (1.5, 1.5))
    assert error(floor.model, floor.p) < 0.5 * error(*flat_fit(seen, vehicle))
