"""The same flight as CSV, as a MATLAB file and as MCAP; times of a link; a measured slope map."""

import csv
import json

import numpy as np
import pytest
from click.testing import CliRunner
from scipy.io import savemat

from lab_mcap import write_mcap
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
    cells = ({"log": dict(zip(head, map(float, row), strict=True))} for row in rows)
    write_mcap(path, ["/log"], ((row["log"]["t_s"], row) for row in cells))


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


def test_a_doubled_row_of_a_slope_map_names_the_missing_node(tmp_path):
    path = slopes(tmp_path / "map.csv", (-2, 0, 2))
    lines = path.read_text().splitlines()
    path.write_text("\n".join([*lines[:-1], lines[1]]))
    code, found = run("calibrate", "slope", path, "--ax", "ax", "--ay", "ay", "--json")
    assert code == 2
    assert "no row at (2, 1), two at (-2, -1)" in found["found"]


def test_few_pulses_have_a_wide_interval(tmp_path):
    t = np.arange(0.0, 34.0, 0.05)
    on = t % 14.0 >= 6.0
    level = np.where(t < 14.0, 0.340, 0.350)
    rows = [f"{a:.3f},{b:.6f},{int(c)}" for a, b, c in zip(t, level * on, on, strict=True)]
    path = tmp_path / "stand.csv"
    path.write_text("\n".join(["t_s,weight_g,bitmask", *rows]))
    code, found = run("calibrate", "thrust", path, "--unit", "N", "--json")
    assert code == 0
    (jet,) = found["jets"]
    assert jet["pulses"] == 2
    assert jet["high_n"] - jet["thrust_n"] == pytest.approx(12.706 * 0.005, rel=1e-3)


def marker(path, late=0.047, unit=1.0, missing=0, write=str.encode):
    """An encoder and a camera that sees its angle `late` [s]."""

    def angle(t):
        return 30.0 * np.sin(1.3 * t) + 9.0 * np.sin(3.1 * t + 1.0)

    encoder, camera = np.arange(0.0, 30.0, 0.01), np.arange(0.004, 30.0, 1.0 / 60.0)
    samples = [("encoder", t, angle(t)) for t in encoder]
    samples += [("camera", t, angle(t - late) + 2.0) for t in camera]
    rows = [f"{name},{unit * t:.5f},{a:.4f}" for name, t, a in samples]
    for k in range(missing):
        rows[-1 - 50 * k] = rows[-1 - 50 * k].rsplit(",", 1)[0] + ",NaN"
    path.write_bytes(write("\n".join(["source,t_s,angle_deg", *rows])))
    return path


@pytest.mark.parametrize(
    "write",
    [
        lambda text: text.encode("utf-16"),
        lambda text: text.replace(",", ";").replace(".", ",").encode(),
    ],
)
def test_a_latency_log_may_be_written_otherwise_and_have_gaps(tmp_path, write):
    path = marker(tmp_path / "m.csv", missing=9, write=write)
    code, found = run("calibrate", "mocap", path, "--json")
    assert code == 0
    assert found["latency_s"] == pytest.approx(0.047, abs=5e-4)


@pytest.mark.parametrize(
    ("words", "hint"),
    [
        ({"late": -0.03}, "exchanged"),
        ({"unit": 1000.0}, "ms"),
        ({"late": 1.3}, "two clocks"),
    ],
)
def test_an_impossible_latency_is_refused(tmp_path, words, hint):
    code, found = run("calibrate", "mocap", marker(tmp_path / "m.csv", **words), "--json")
    assert code == 2
    assert hint in found["hint"]


def test_a_link_in_milliseconds_is_refused(tmp_path):
    path = tmp_path / "link.csv"
    path.write_text(
        "\n".join(["sent_s,received_s", *(f"{20 * k},{20 * k + 8}" for k in range(99))])
    )
    code, found = run("calibrate", "link", path, "--json")
    assert code == 2
    assert "ms" in found["hint"]
