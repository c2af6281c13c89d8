"""The same flight as CSV, as a MATLAB file and as MCAP; times of a link; a measured slope map."""

import csv
import json

import numpy as np
import pytest
from click.testing import CliRunner
from mcap.writer import Writer
from scipy.io import savemat

from testbed.cli.main import main
from testbed.core.table import Table
from testbed.identification.mapping import load_mapping
from testbed.identification.motion_log import read_motion_log
from testbed.identification.table_file import load_table


def run(*words):
    result = CliRunner().invoke(main, [str(word) for word in words])
    return result.exit_code, json.loads(result.stdout)


def columns_of(path):
    with path.open(newline="") as file:
        head, *rows = list(csv.reader(file))
    return head, np.array(rows, dtype=float)


def as_mat(path, head, rows):
    savemat(path, {"log": {name: rows[:, k] for k, name in enumerate(head)}})


def as_mcap(path, head, rows):
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        schema = writer.register_schema("Row", "jsonschema", b"{}")
        channel = writer.register_channel("/log", "json", schema)
        for row in rows:
            at = round(1e9 * row[0])
            tree = {"log": dict(zip(head, map(float, row), strict=True))}
            writer.add_message(channel, at, json.dumps(tree).encode(), at)
        writer.finish()


@pytest.mark.parametrize(("suffix", "write"), [(".mat", as_mat), (".mcap", as_mcap)])
def test_a_flight_in_another_format_is_the_same_flight(files, tmp_path, suffix, write):
    mapping, log, _ = files
    other, named = tmp_path / f"log{suffix}", tmp_path / "own.toml"
    write(other, *columns_of(log))
    text = mapping.read_text()
    for name in ("t_s", "x_m", "y_m", "theta_rad", "duty_"):
        text = text.replace(f'"{name}', f'"log.{name}')
    named.write_text(text)
    a = read_motion_log(log, load_mapping(str(mapping)))
    b = read_motion_log(other, load_mapping(str(named)))
    np.testing.assert_allclose(b.pose, a.pose, atol=1e-12)
    np.testing.assert_allclose(b.inputs.up, a.inputs.up, atol=1e-12)
    code, found = run("validate", other, "--mapping", named, "--vehicle", "generic_8jet", "--json")
    assert code == 0
    assert found["horizons"]["3"]["vehicle"]["count"] > 50


@pytest.mark.parametrize("suffix", [".mat", ".mcap"])
def test_a_broken_file_is_refused(files, tmp_path, suffix):
    path = tmp_path / f"log{suffix}"
    path.write_bytes(b"no log")
    words = "--mapping", files[0], "--vehicle", "generic_8jet", "--json"
    code, found = run("calibrate", "motion", path, *words)
    assert code == 2
    assert found["refused"]


def test_the_numbers_of_a_link_are_those_of_its_times(tmp_path):
    rng = np.random.default_rng(4)
    sent = 0.1 * np.arange(3000)
    late = 0.005 + rng.exponential(0.003, 3000)
    lost = rng.random(3000) < 0.1
    path = tmp_path / "link.csv"
    rows = [
        f"{s:.6f},{'' if gone else f'{s + d:.6f}'}"
        for s, d, gone in zip(sent, late, lost, strict=True)
    ]
    path.write_text("\n".join(["sent_s,received_s", *rows]))
    code, found = run("calibrate", "link", path, "--json")
    assert code == 0
    assert found["delay_s"] == pytest.approx(0.005, abs=2e-4)
    assert found["jitter_s"] == pytest.approx(0.003, rel=0.1)
    assert found["loss"] == pytest.approx(0.1, abs=0.02)
    assert found["burst_loss"] == 0.0


def slopes(path, x):
    rows = [f"{a},{b},{10 * a},{-5 * b}" for a in x for b in (-1, -0.5, 0, 0.5, 1)]
    path.write_text("\n".join(["x_m,y_m,ax,ay", *rows]))
    return path


def test_a_measured_slope_map_is_a_table_that_can_fly(tmp_path):
    path, out, page = slopes(tmp_path / "map.csv", (-2, 0, 2)), tmp_path / "t.toml", tmp_path / "p"
    words = "--ax", "ax", "--ay", "ay", "--unit", "mm/s^2", "--json"
    code, found = run("calibrate", "slope", path, *words, "--out", out, "--page", page)
    assert code == 0
    assert found["size_m"] == [4.0, 2.0]
    assert found["nodes"] == [3, 5]
    table: Table = load_table(str(out))
    assert table.tilt.map[4][0] == pytest.approx((-0.02, -0.005))
    assert "<svg" in page.read_text()
    assert CliRunner().invoke(main, ["check", "hold", f"table={out}"]).exit_code == 0


def test_an_uneven_slope_map_is_refused(tmp_path):
    path = slopes(tmp_path / "map.csv", (-2, 0, 1.5))
    code, found = run("calibrate", "slope", path, "--ax", "ax", "--ay", "ay", "--json")
    assert code == 2
    assert "even grid" in found["expected"]
