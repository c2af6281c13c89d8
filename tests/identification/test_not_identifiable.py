"""A number that a log does not tell keeps the file's value, and the file written says so."""

from datetime import date

import numpy as np
import pytest
from msgspec import structs

from testbed.config.tree import read_toml
from testbed.identification.calibration_file import report_of, save
from testbed.identification.jets import examine
from testbed.identification.model import VehicleModel
from testbed.identification.motion import (
    _certain,
    _out_of_time,
    calibrate_motion,
    identifiable,
    thrusts,
)
from testbed.identification.prediction import Valves
from testbed.identification.suspicion import start_of
from testbed.identification.synthetic import excitation, flown_log
from testbed.identification.vehicle_file import load_vehicle
from testbed.identification.windows import tiled

PLACES = {"inertia": "inertia", "drag": "drag", "spin_drag": "spin_drag"}


def sparse(vehicle, seconds, share, rng):
    inputs = excitation(vehicle, seconds, 0.1, rng, room=0.6)
    keep = rng.random(len(inputs.up)) < share
    return Valves(inputs.up[keep], inputs.down[keep], inputs.jet[keep])


@pytest.fixture(scope="module")
def quiet(floater):
    """A short flight with few pulses, with jets at 0.8 of the file's thrust."""
    rng = np.random.default_rng(1)
    jets = [structs.replace(jet, thrust=0.8 * jet.thrust) for jet in floater.jets]
    truth = structs.replace(floater, jets=jets)
    log = flown_log(truth, None, sparse(floater, 10.0, 0.05, rng), 10.0, rng)
    return log, calibrate_motion([log], floater, force=True)


def test_wrong_drag_in_the_file_makes_no_jet_weak():
    file = load_vehicle("uky")
    truth = structs.replace(file, drag=0.0, spin_drag=0.0)
    rng = np.random.default_rng(0)
    log = flown_log(truth, None, sparse(truth, 40.0, 0.35, rng), 40.0, rng)
    model = VehicleModel(file, valves=True)
    found = examine(model, start_of(model, [log], file), [tiled(log, 2.5)])
    assert {one.state for one in found} == {"ok"}


def test_no_jet_is_dead_whose_interval_has_the_files_thrust_in_it(quiet):
    _, found = quiet
    dead = found._replace(jets=[one._replace(state="dead") for one in found.jets])
    inside = [row["jet"] for row in thrusts(dead) if row["high_n"] >= row["file_n"]]
    assert inside
    assert not [one for one in _certain(dead) if one.state == "dead" and one.jet + 1 in inside]


def test_what_is_not_identifiable_keeps_the_files_value(quiet, floater):
    log, found = quiet
    report = report_of(found, "generic_8jet", [log])
    unknown = [row for row in report["parameters"].values() if not row["identifiable"]]
    assert not report["parameters"]["thrust"]["identifiable"]
    assert report["kept"]
    for row in unknown:
        assert row["value"] == pytest.approx(row["file"])
        assert not row["chosen"]
        assert row["low"] <= row["file"] <= row["high"]
    for row, jet in zip(report["jets"], floater.jets, strict=True):
        if not row["identifiable"]:
            assert row["thrust_n"] == jet.thrust


def test_a_comment_as_in_the_file_is_true(quiet, tmp_path):
    log, found = quiet
    path = tmp_path / "own.toml"
    save(path, found, "generic_8jet", [log], date(2026, 1, 1))
    text, own = path.read_text(), read_toml(path)
    file = load_vehicle("generic_8jet")
    for line in text.splitlines():
        name = line.split(" = ")[0]
        if "as in generic_8jet" in line and name in PLACES:
            assert own[name] == pytest.approx(getattr(file, name), rel=1e-5), line
    jets = [line for line in text.splitlines() if "thrust =" in line and "position" in line]
    for line, now, before in zip(jets, own["jets"], file.jets, strict=True):
        if "as in generic_8jet" in line and "common" not in line:
            assert now["thrust"] == pytest.approx(before.thrust, rel=1e-5), line
    assert "as in generic_8jet, not identifiable" in text


def test_a_number_is_identifiable_by_its_printed_interval(flight, floater):
    found = calibrate_motion([flight[1]], floater)
    k = found.model.index("com_y")
    assert identifiable(found, k)
    wide = found.wide._replace(p=found.wide.p.copy())
    wide.p[k] += 0.016  # the choice of groups moved it far: the interval is wide
    assert not identifiable(found._replace(wide=wide), k)


def test_a_negative_delay_is_named_and_its_comment_true(flight, floater, tmp_path):
    log = flight[1]
    early = log._replace(t=log.t - 0.06)
    found = calibrate_motion([early], floater)
    assert [one.name for one in found.suspicions if not one.refuses] == ["negative-delay"]
    wide = found.wide._replace(p=found.wide.p.copy())
    wide.p[found.model.index("delay")] += 0.2  # now its interval has a delay that can be
    assert _out_of_time(found._replace(wide=wide)) == []
    path = tmp_path / "own.toml"
    save(path, found, "generic_8jet", [early], date(2026, 1, 1))
    line = next(one for one in path.read_text().splitlines() if one.startswith("open_delay_s"))
    assert line.startswith("open_delay_s = 0.0  # delay: 0, because no delay is negative")


def test_a_delay_with_a_wide_interval_keeps_the_files_value(floater):
    rng = np.random.default_rng(2)
    truth = structs.replace(
        floater,
        jets=[structs.replace(jet, thrust=0.8 * jet.thrust) for jet in floater.jets],
        air=structs.replace(floater.air, droop=0.5),
    )
    log = flown_log(truth, None, sparse(floater, 10.0, 0.05, rng), 10.0, rng, rate=10.0)
    found = calibrate_motion([log], floater, force=True)
    row = report_of(found, "generic_8jet", [log])["parameters"]["delay"]
    assert not row["identifiable"]
    assert row["value"] == floater.valve.open_delay_s
