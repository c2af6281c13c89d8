"""A slope map is right also where the vehicle file is not, and its uncertainty is honest."""

import json
from datetime import date

import numpy as np
import pytest
from click.testing import CliRunner

from testbed.cli.main import main
from testbed.identification.calibration_file import save_with_map
from testbed.identification.floor import learn_floor


@pytest.fixture(scope="module")
def learned(flight, floater):
    reach = 2.2 * np.abs(flight[1].pose[:, :2]).max(axis=0)
    return learn_floor([flight[1]], floater, (float(reach[0]), float(reach[1])), 5)


def test_wrong_jets_in_the_file_make_no_slope(learned):
    told = learned.sigma.min(axis=2) < 0.5 * learned.sigma.max()
    z = (learned.slope / learned.sigma)[told]  # the table is level
    assert told.sum() >= 4
    assert np.sqrt(np.mean(z**2)) < 1.5
    assert np.median(np.abs(learned.slope[told])) < 1e-3


def test_the_vehicle_of_a_slope_map_has_its_own_jets(learned, flight):
    own = learned.model.fitted(learned.p)
    for jet, true in zip(own.jets, flight[0].jets, strict=True):
        assert jet.thrust == pytest.approx(true.thrust, rel=0.02)


def test_the_file_of_a_slope_map_says_where_its_numbers_come_from(learned, tmp_path):
    path = tmp_path / "own.toml"
    save_with_map(path, learned, "generic_8jet", ["log.csv"], date(2026, 1, 1))
    text = path.read_text()
    assert "`testbed calibrate floor`" in text
    mass = next(line for line in text.splitlines() if line.startswith("mass = "))
    assert "only thrust over mass" in mass
    jets = [line for line in text.splitlines() if "thrust =" in line and "push" in line]
    assert all("fitted with the slope map, 0." in line for line in jets)


@pytest.mark.parametrize("verb", ["floor", "mocap"])
def test_what_motion_refuses_is_refused(files, tmp_path, verb):
    mapping, _, write = files
    swapped = ["t_s", "y_m", "x_m", "theta_rad", *(f"duty_{k + 1}" for k in range(8))]
    log, out = write(f"swapped_{verb}.csv", head=swapped), tmp_path / "table.toml"
    words = ["calibrate", verb, log, "--mapping", mapping, "--vehicle", "generic_8jet", "--json"]
    words += ["--out", out, "--nodes", 3] * (verb == "floor")
    result = CliRunner().invoke(main, [str(word) for word in words])
    assert result.exit_code == 2
    assert [one["name"] for one in json.loads(result.stdout)["suspicions"]] == ["axes-swapped"]
    assert not out.exists()
    if verb == "mocap":
        result = CliRunner().invoke(main, [str(word) for word in [*words, "--force"]])
        assert result.exit_code == 0


@pytest.mark.parametrize("middle", [(2.0, 0.0), (0.0, -20.0)])
def test_a_path_beside_the_table_is_refused(files, tmp_path, middle):
    mapping, log, _ = files
    moved, out = tmp_path / "moved.toml", tmp_path / "table.toml"
    text = mapping.read_text().replace("[pose]\n", f"[pose]\nmiddle = {list(middle)}\n")
    moved.write_text(text)
    words = ["calibrate", "floor", log, "--mapping", moved, "--vehicle", "generic_8jet"]
    words += ["--size", 3.0, 3.0, "--out", out]
    result = CliRunner().invoke(main, [str(word) for word in words])
    assert result.exit_code == 2
    assert "expected  a path on the table of 3 m x 3 m" in result.stderr
    assert "see `middle`" in result.stderr
    assert not out.exists()


@pytest.mark.parametrize(
    ("given", "size", "guessed"),
    [([], "6 m x 6 m", True), (["--size", 5.0, 4.0], "5 m x 4 m", False)],
)
def test_the_size_of_the_map_is_printed_and_a_guess_is_a_warning(files, given, size, guessed):
    mapping, log, _ = files
    assert "table =" not in mapping.read_text()
    words = ["calibrate", "floor", log, "--mapping", mapping, "--vehicle", "generic_8jet"]
    result = CliRunner().invoke(main, [str(word) for word in [*words, "--nodes", 3, *given]])
    assert result.exit_code == 0, result.stderr
    assert f"slope map of 3 x 3 nodes over {size}" in result.stdout
    assert ("the mapping has no `table`" in result.stderr) == guessed
