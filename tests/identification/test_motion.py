"""A fit finds the true numbers of a flight, and says what it cannot know."""

import json
from datetime import date

import msgspec
import numpy as np
import pytest
from click.testing import CliRunner
from msgspec import structs

from testbed.cli.main import main
from testbed.config import SHIPPED, load
from testbed.identification.calibration_file import findings, report_of
from testbed.identification.jets import JetFinding, examine
from testbed.identification.model import VehicleModel
from testbed.identification.motion import calibrate_motion, identifiable, interval, thrusts
from testbed.identification.synthetic import excitation, flown_log
from testbed.identification.table_file import load_table
from testbed.identification.vehicle_file import load_vehicle, write_vehicle
from testbed.identification.windows import tiled


@pytest.fixture(scope="module")
def found(flight, floater):
    return calibrate_motion([flight[1]], floater)


def test_thrust_inertia_centre_of_mass_and_delay_are_found(found, flight, floater):
    truth, _ = flight
    for row, jet in zip(thrusts(found), truth.jets, strict=True):
        assert row["thrust_n"] == pytest.approx(jet.thrust, rel=0.03)
        assert row["low_n"] < row["thrust_n"] < row["high_n"]
        assert row["identifiable"]
    got = found.vehicle
    assert got.inertia == pytest.approx(truth.inertia, rel=0.03)
    assert got.com == pytest.approx(truth.com, abs=2e-3)
    assert got.valve.open_delay_s == pytest.approx(truth.valve.open_delay_s, abs=3e-3)
    slope = [found.estimate.p[found.model.index(a)] for a in ("slope_x", "slope_y")]
    assert slope == pytest.approx([0.0, 0.0], abs=2e-4)
    low, high = interval(found, found.model.index("inertia"))
    assert low < truth.inertia / floater.inertia < high


def test_every_number_of_a_report_is_json(found, flight):
    tree = report_of(found, "generic_8jet", [flight[1]])
    assert msgspec.json.decode(msgspec.json.encode(tree))["jets"][0]["jet"] == 1
    assert "mass (only thrust over mass)" in tree["not_identifiable"]
    assert tree["findings"] == []


def examined(flight, floater, change):
    truth, log = flight
    altered = change(truth)
    rng = np.random.default_rng(2)
    other = flown_log(altered, None, log.inputs, 60.0, rng)
    model = VehicleModel(floater, valves=True)
    return {f.jet + 1: f for f in examine(model, model.prior, [tiled(other, 2.5)])}


def with_thrust(truth, jet, factor):
    jets = list(truth.jets)
    jets[jet - 1] = structs.replace(jets[jet - 1], thrust=jets[jet - 1].thrust * factor)
    return structs.replace(truth, jets=jets)


@pytest.mark.parametrize(("factor", "state"), [(1e-3, "dead"), (0.5, "weak")])
def test_a_dead_and_a_weak_jet_are_named(flight, floater, factor, state):
    found = examined(flight, floater, lambda v: with_thrust(v, 3, factor))
    assert {k: f.state for k, f in found.items() if f.state != "ok"} == {3: state}


def test_exchanged_jets_are_named(flight, floater):
    def change(v):
        jets = list(v.jets)
        jets[1], jets[4] = jets[4], jets[1]
        return structs.replace(v, jets=jets)

    found = examined(flight, floater, change)
    assert {k: f.other + 1 for k, f in found.items() if f.state == "exchanged"} == {2: 5, 5: 2}


def test_exchanged_jets_are_listed_once(found):
    pair = [JetFinding(k, "exchanged", 1.0, 0.1, other) for k, other in ((1, 4), (4, 1))]
    assert findings(found._replace(jets=pair)) == ["jets 2 and 5 are exchanged"]


def test_a_jet_that_never_opened_is_not_identifiable(floater):
    rng = np.random.default_rng(3)
    used = np.arange(8) != 6
    log = flown_log(floater, None, excitation(floater, 40.0, 0.1, rng, used), 40.0, rng)
    found = calibrate_motion([log], floater)
    row = thrusts(found)[6]
    assert row["state"] == "not excited"
    assert not row["identifiable"]
    assert identifiable(found, 0)
    assert "thrust of jet 7" in report_of(found, "generic_8jet", [log])["not_identifiable"]


def run(*words):
    result = CliRunner().invoke(main, [str(word) for word in words])
    return result.exit_code, result.stdout


def test_from_a_log_to_a_vehicle_file_to_a_verdict(files, tmp_path):
    mapping, log, _ = files
    out, page = tmp_path / "own.toml", tmp_path / "page.html"
    common = ["--mapping", mapping, "--json"]
    code, text = run(
        "calibrate",
        "motion",
        log,
        *common,
        "--vehicle",
        "generic_8jet",
        "--until",
        40,
        "--out",
        out,
    )
    assert code == 0
    assert json.loads(text)["out"] == str(out)
    head = out.read_text()
    assert json.loads(text)["logs"][0]["sha256"] in head
    assert "fitted," in head
    assert load_vehicle(str(out)).jets[0].thrust == pytest.approx(
        json.loads(text)["jets"][0]["thrust_n"], rel=1e-4
    )
    code, text = run(
        "validate", log, *common, "--vehicle", out, "--against", "generic_8jet", "--from", 41,
        "--out", page,
    )  # fmt: skip
    assert code == 0
    verdict = json.loads(text)
    for h in ("1", "3", "5"):
        both = verdict["horizons"][h]
        assert both["vehicle"]["position_rms_m"] < 0.5 * both["against"]["position_rms_m"]
        assert both["vehicle"]["heading_rms_deg"] < both["against"]["heading_rms_deg"]
    assert verdict["vehicle"]["horizons"]["3"] == verdict["horizons"]["3"]["vehicle"]
    assert verdict["seen_by_the_fit"] == []
    code, text = run("validate", log, *common, "--vehicle", out, "--from", 35, "--until", 45)
    assert json.loads(text)["seen_by_the_fit"] == [str(log)]
    assert "<svg" in page.read_text()
    assert "The compared file is generic_8jet" in page.read_text()
    code, text = run("validate", log, *common, "--vehicle", out, "--out", page)
    assert "Warning: " in page.read_text()
    code, _ = run("check", "hold", f"vehicles.sat1.model={out}")
    assert code == 0


def test_a_suspicion_is_a_refusal_and_writes_nothing(files, tmp_path):
    mapping, _, write = files
    swapped = ["t_s", "y_m", "x_m", "theta_rad", *(f"duty_{k + 1}" for k in range(8))]
    log, out = write("swapped.csv", head=swapped), tmp_path / "own.toml"
    code, text = run(
        "calibrate", "motion", log, "--mapping", mapping, "--vehicle", "generic_8jet", "--json",
        "--out", out,
    )  # fmt: skip
    assert code == 2
    assert [one["name"] for one in json.loads(text)["suspicions"]] == ["axes-swapped"]
    assert not out.exists()


def test_another_vehicle_is_not_fitted_over(flight, floater):
    heavy = structs.replace(floater, mass=1.7 * floater.mass, inertia=1.7 * floater.inertia)
    with pytest.raises(Exception, match="other-vehicle"):
        calibrate_motion([flight[1]], heavy)


def test_a_run_folder_needs_no_mapping(tmp_path):
    folder = tmp_path / "run"
    words = ["run", "hold", "duration_s=30", "criteria={}", "--seed", "3", "--json", "--out"]
    assert run(*words, folder)[0] == 0
    code, text = run("validate", folder, "--vehicle", "generic_8jet", "--json")
    assert code == 0
    verdict = json.loads(text)
    assert verdict["horizons"]["3"]["vehicle"]["position_rms_m"] < 0.02
    code, text = run("validate", folder, "--vehicle", "generic_8jet", "--body", "sat9", "--json")
    assert code == 2
    assert "sat1" in json.loads(text)["expected"]


def test_the_table_file_has_the_size_of_the_mapping(files, tmp_path):
    mapping, log, _ = files
    sized, out = tmp_path / "sized.toml", tmp_path / "table.toml"
    sized.write_text("table = [3.5, 2.4]\n" + mapping.read_text())
    words = ["--vehicle", "generic_8jet", "--until", 20, "--table-out", out, "--json"]
    assert run("calibrate", "motion", log, "--mapping", sized, *words)[0] == 0
    assert load_table(str(out)).size == (3.5, 2.4)


def test_the_table_file_of_a_run_has_the_size_of_its_table(tmp_path):
    folder, out = tmp_path / "run", tmp_path / "table.toml"
    flown = "run hold duration_s=30 criteria={} table.size=[4.3,4.1] --seed 3 --json --out"
    assert run(*flown.split(), folder)[0] == 0
    words = ["--vehicle", "generic_8jet", "--table-out", out, "--json", "--force"]
    code, text = run("calibrate", "motion", folder, *words)
    assert code == 0, text
    assert load_table(str(out)).size == load(folder / "config.toml").table.size


def test_results_are_on_standard_output_and_steps_on_standard_error(files):
    mapping, log, _ = files
    words = [log, "--mapping", mapping, "--vehicle", "generic_8jet", "--until", 20]
    fitted = CliRunner().invoke(main, ["calibrate", "motion", *map(str, words)])
    assert "jet 1 " in fitted.stdout
    assert "cross-validate" not in fitted.stdout
    assert "cross-validate" in fitted.stderr
    judged = CliRunner().invoke(main, ["validate", *map(str, words)])
    assert "s ahead" in judged.stdout
    words = ["excite", "--vehicle", "generic_8jet", "--seconds", "20"]
    designed = CliRunner().invoke(main, words)
    assert designed.exit_code == 0, designed.output
    assert "pulses" in designed.stdout


def test_a_log_without_a_mapping_is_refused(files):
    code, text = run("validate", files[1], "--vehicle", "generic_8jet", "--json")
    assert code == 2
    assert json.loads(text)["where"] == "--mapping"


@pytest.mark.parametrize("name", ["uky", "spot_red", "spot_black", "spot_red_2021_07", "ita"])
def test_the_vehicles_of_the_labs_can_fly(name):
    path = SHIPPED / "vehicles" / f"{name}.toml"
    code, text = run("check", "hold", f"vehicles.sat1.model={path}")
    assert code == 0, text


def test_a_valve_that_closes_late_has_time_to_close(floater, tmp_path):
    model = VehicleModel(floater, valves=True)
    p = model.prior.copy()
    p[model.index("hold")] = 0.0412345678
    path = tmp_path / "late.toml"
    write_vehicle(path, model.fitted(p), {}, [], date(2026, 1, 1))
    assert run("check", "hold", f"vehicles.sat1.model={path}")[0] == 0


@pytest.mark.parametrize("part", [("--until", 1), ("--from", 1000), ("--until", 3)])
@pytest.mark.parametrize("verb", [("calibrate", "motion"), ("validate",), ("calibrate", "floor")])
def test_too_little_flight_is_refused(files, verb, part):
    mapping, log, _ = files
    code, text = run(*verb, log, "--mapping", mapping, "--vehicle", "generic_8jet", *part, "--json")
    assert code in (0, 2) if part == ("--until", 3) else code == 2, text
    assert json.loads(text)
