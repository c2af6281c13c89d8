"""What the vehicle file, the log and the command line already say about a calibration."""

import json

import numpy as np
import pytest
from click.testing import CliRunner
from msgspec import structs

from testbed.cli.main import main
from testbed.identification.motion import calibrate_motion, identifiable, thrusts
from testbed.identification.synthetic import excitation, flown_log
from testbed.identification.validation import validate


def run(*words):
    return CliRunner().invoke(main, [str(word) for word in words])


def lighter(vehicle, factor):
    return structs.replace(vehicle, mass=factor * vehicle.mass, inertia=factor * vehicle.inertia)


@pytest.fixture(scope="module")
def sparse_log(floater):
    """A vehicle as in its file that hardly pushes."""
    rng = np.random.default_rng(4)
    inputs = excitation(floater, 30.0, 0.1, rng, room=0.6)
    keep = rng.random(len(inputs.up)) < 0.15
    few = type(inputs)(inputs.up[keep], inputs.down[keep], inputs.jet[keep])
    return flown_log(floater, None, few, 30.0, rng)


def test_a_file_that_knows_a_number_better_keeps_it(sparse_log, floater):
    found = calibrate_motion([sparse_log], floater)
    for row, jet in zip(thrusts(found), floater.jets, strict=True):
        wide = row["high_n"] - row["low_n"] > 4 * 1.96 * floater.tolerance.thrust * jet.thrust
        if wide and row["low_n"] < jet.thrust < row["high_n"]:
            assert not row["identifiable"]
    for name, known in (("inertia", floater.tolerance.inertia), ("com_x", floater.tolerance.com)):
        k = found.model.index(name)
        far = found.wide.sigma[k]
        assert far < 2 * known or not identifiable(found, k)


def test_a_file_that_the_log_contradicts_does_not(flight, floater):
    """It says that the inertia is known to 0.1 %, and is wrong by a third."""
    exact = structs.replace(floater.tolerance, inertia=1e-3)
    wrong = structs.replace(floater, inertia=1.3 * floater.inertia, tolerance=exact)
    found = calibrate_motion([flight[1]], wrong, force=True)
    assert identifiable(found, found.model.index("inertia"))
    assert found.vehicle.inertia == pytest.approx(flight[0].inertia, rel=0.02)


def test_both_files_are_validated_on_the_same_table(flight, floater, table):
    steep = structs.replace(table, tilt=structs.replace(table.tilt, uniform=(0.01, 0.0), map=[]))
    one, other = floater, lighter(floater, 1.2)
    there, _ = validate([flight[1]], one, other, steep)
    back, _ = validate([flight[1]], other, one, steep)
    for h, both in there["horizons"].items():
        assert both["vehicle"] == back["horizons"][h]["against"]
        assert both["against"] == back["horizons"][h]["vehicle"]


def test_a_log_that_the_file_was_fitted_to_is_warned_of(files, tmp_path):
    mapping, log, _ = files
    own, words = tmp_path / "own.toml", ("calibrate", "motion", log, "--mapping", mapping)
    assert "fitted to this log" not in run(*words, "--vehicle", "generic_8jet", "--out", own).stderr
    again = run(*words, "--vehicle", own, "--json")
    assert f"{own} was fitted to this log already" in again.stderr
    assert json.loads(again.stdout)["jets"]


def test_the_offset_of_the_body_is_that_of_the_calibration(files, flight):
    """Single jets are fitted with it: their differences look like a centre of mass elsewhere."""
    mapping, log, _ = files
    words = ("--mapping", mapping, "--vehicle", "generic_8jet", "--json")
    found = json.loads(run("calibrate", "mocap", log, *words).stdout)
    fitted = json.loads(run("calibrate", "motion", log, *words).stdout)["parameters"]
    for axis, true in zip("xy", flight[0].com, strict=True):
        row = found[f"body_offset_{axis}"]
        assert row["value"] == pytest.approx(-fitted[f"com_{axis}"]["value"], abs=1e-12)
        assert row["low"] <= -true <= row["high"]


def test_a_part_without_flight_names_the_log_s_time(files):
    mapping, log, _ = files
    result = run(
        "calibrate", "motion", log, "--mapping", mapping, "--vehicle", "generic_8jet",
        "--from", 1000,
    )  # fmt: skip
    assert result.exit_code == 2
    assert "flight from 0.000 to 5" in result.stderr or "flight from 0.000 to 6" in result.stderr


@pytest.mark.parametrize(
    ("old", "new", "found"),
    [
        (', "duty_8"]', "]", "expected  8 columns"),
        ('"duty_8"', '"duty_7"', 'found     "duty_7" twice'),
        ('y = "y_m"', 'y = "x_m"', 'found     "x_m" twice'),
    ],
)
@pytest.mark.parametrize("verb", [("calibrate", "motion"), ("calibrate", "floor"), ("validate",)])
def test_valve_columns_are_counted(files, tmp_path, verb, old, new, found):
    mapping, log, _ = files
    wrong = tmp_path / "wrong.toml"
    wrong.write_text(mapping.read_text().replace(old, new))
    result = run(*verb, log, "--mapping", wrong, "--vehicle", "generic_8jet")
    assert result.exit_code == 2
    assert found in result.stderr


@pytest.mark.parametrize("verb", [("calibrate", "motion"), ("calibrate", "floor"), ("excite",)])
def test_a_missing_folder_is_named_before_the_work(files, tmp_path, verb):
    mapping, log, _ = files
    words = [*verb, "--vehicle", "generic_8jet", "--out", tmp_path / "none" / "own.toml"]
    words += [log, "--mapping", mapping] * (verb != ("excite",))
    result = run(*words)
    assert result.exit_code == 2
    assert "expected  a file in a folder that exists" in result.stderr
    assert "read" not in result.stderr.splitlines()[0]
