"""Logs as labs write them: other marks, other encodings, quaternions, two vehicles in one file."""

import csv
import gzip
import json
import re
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from scipy.io import savemat

from lab_mcap import write_mcap
from testbed.cli.main import main
from testbed.config import ConfigError
from testbed.identification.calibration_file import span
from testbed.identification.columns import LogRefusedError
from testbed.identification.mapping import load_mapping
from testbed.identification.motion_log import read_motion_log
from testbed.identification.suspicion import suspicions


def read(path, mapping):
    return read_motion_log(path, load_mapping(str(mapping)))


def rows_of(path):
    with path.open(newline="") as file:
        head, *rows = list(csv.reader(file))
    return head, rows


def text_of(head, rows, mark=","):
    return "\n".join(mark.join(row) for row in [head, *rows])


def in_german(text):
    return text.replace(",", ";").replace(".", ",")


@pytest.mark.parametrize(
    ("name", "write"),
    [
        ("log.csv.gz", lambda text: gzip.compress(text.encode())),
        ("log.csv", lambda text: gzip.compress(text.encode())),
        ("plain.csv.gz", lambda text: text.encode()),
        ("marked.csv", lambda text: text.encode("utf-8-sig")),
        ("excel.txt", lambda text: text.encode("utf-16")),
        ("lines.csv", lambda text: text.replace("\n", "\r\n").encode()),
        ("german.csv", lambda text: in_german(text).encode()),
        ("tabs.tsv", lambda text: text.replace(",", "\t").encode()),
        ("bare.txt", lambda text: text.encode("utf-16-le")),
        ("excel.csv", lambda text: f"sep=;\n{text.replace(',', ';')}".encode()),
        (
            "spaced.csv",
            lambda text: re.sub(r"[^,\n]+", r'"\g<0>"', text).replace(",", ", ").encode(),
        ),
        ("padded.csv", lambda text: text.replace("\n", ",,\n").encode() + b",,,\n,,,\n"),
        ("export.csv", lambda text: b"Format Version,1.23,Rate,120\n\nTake 7\n" + text.encode()),
        ("noted.csv", lambda text: f"# gr\u00fcn\n% {text}".replace("% ", "").encode("latin-1")),
    ],
)
def test_the_same_log_written_otherwise_is_the_same_log(files, tmp_path, name, write):
    mapping, log, _ = files
    path = tmp_path / name
    path.write_bytes(write(text_of(*rows_of(log))))
    one, other = read(log, mapping), read(path, mapping)
    np.testing.assert_array_equal(other.pose, one.pose)
    np.testing.assert_array_equal(other.inputs.up, one.inputs.up)


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (b"PK\x03\x04rest", "save it as CSV"),
        (b"t_s,x_m\0", "binary"),
        (b"\x1f\x8bbroken", "a CSV, .mat or .mcap file"),
        (b"", "an empty file"),
    ],
)
def test_a_file_that_is_no_text_is_refused(files, tmp_path, data, words):
    path = tmp_path / "log.csv"
    path.write_bytes(data)
    with pytest.raises(LogRefusedError, match=words):
        read(path, files[0])


def test_a_row_of_units_is_named(files, tmp_path):
    head, rows = rows_of(files[1])
    path = tmp_path / "units.csv"
    path.write_text(text_of(head, [["s", "m", "m", "rad", *"--------"], *rows]))
    with pytest.raises(LogRefusedError, match="row of units"):
        read(path, files[0])


def test_values_with_no_mark_between_them_are_named(files, tmp_path):
    path = tmp_path / "spaces.csv"
    path.write_text(text_of(*rows_of(files[1]), " "))
    with pytest.raises(LogRefusedError, match="commas, semicolons or tabs between"):
        read(path, files[0])


def test_only_a_column_that_is_used_needs_a_name_of_its_own(files, tmp_path):
    mapping, log, _ = files
    head, rows = rows_of(log)
    path = tmp_path / "twice.csv"
    path.write_text(text_of([*head, "note", "note"], [[*row, "1", "2"] for row in rows]))
    np.testing.assert_array_equal(read(path, mapping).pose, read(log, mapping).pose)
    path.write_text(text_of([*head, "x_m"], [[*row, "1"] for row in rows]))
    with pytest.raises(LogRefusedError, match="two columns 'x_m'"):
        read(path, mapping)


def test_times_of_day_are_named(files, tmp_path):
    head, rows = rows_of(files[1])
    path = tmp_path / "utc.csv"
    for stamp in ("2026-11-28T09:00:00.05Z", "09:00:00.05", "28.11.2026 09:00:00"):
        path.write_text(text_of(head, [[stamp, *row[1:]] for row in rows]))
        with pytest.raises(LogRefusedError, match="seconds since any start"):
            read(path, files[0])


def test_times_since_1970_are_read_and_named_with_all_digits(files, tmp_path):
    mapping, log, _ = files
    head, rows = rows_of(log)
    late = [[repr(1.8e9 + float(row[0])), *row[1:]] for row in rows]
    path = tmp_path / "epoch.csv"
    path.write_text(text_of(head, late))
    np.testing.assert_allclose(read(path, mapping).t - 1.8e9, read(log, mapping).t, atol=1e-6)
    assert span(read(path, mapping)).endswith("of t = 1800000000 to 1800000059.95 s")
    path.write_text(text_of(head, [*late[:9], *late[8:]]))
    with pytest.raises(LogRefusedError, match=r"1800000000\.4 s, then 1800000000\.4 s"):
        read(path, mapping)


def test_seconds_that_are_called_milliseconds_are_refused_where_a_row_is_a_period(files, tmp_path):
    mapping = changed(files, tmp_path, 'column = "t_s"', 'column = "t_s"\nunit = "ms"')
    head, rows = rows_of(files[1])
    path = tmp_path / "slow.csv"
    path.write_text(text_of(head, [["%.3f" % (0.11 * k), *row[1:]] for k, row in enumerate(rows)]))
    with pytest.raises(LogRefusedError, match="is the unit of time 'ms'"):
        read(path, mapping)


@pytest.mark.parametrize("cell", ["", "NaN", "NA", "N/A", "#N/A", "null", "None", "-", "0.0"])
def test_the_pose_of_a_lost_body_is_left_out(files, tmp_path, cell):
    mapping, log, _ = files
    head, rows = rows_of(log)
    for row in rows[300:700:40]:
        row[1:4] = [cell] * 3
    path = tmp_path / "lost.csv"
    path.write_text(text_of(head, rows))
    found, whole = read(path, mapping), read(log, mapping)
    np.testing.assert_array_equal(found.t, np.delete(whole.t, np.s_[300:700:40]))
    assert any("lost body: 10 rows" in note for note in found.notes) == (cell == "0.0")


def test_poses_far_from_all_others_are_named(files, tmp_path, floater):
    head, rows = rows_of(files[1])
    for row in rows[300:700:40]:
        row[1] = row[2] = "-9999"
    path = tmp_path / "far.csv"
    path.write_text(text_of(head, rows))
    assert [s.name for s in suspicions([read(path, files[0])], floater)] == ["lost-poses"]


def test_many_poses_are_averaged_and_tell_the_same(files, tmp_path):
    mapping, log, _ = files
    head, rows = rows_of(log)
    seen = np.array(rows, dtype=float)[:400]
    t = np.arange(0.0, 19.9, 1e-3)
    fine = np.stack([np.interp(t, seen[:, 0], column) for column in seen.T], axis=1)
    fine[:, 4:] = seen[np.minimum((t / 0.05 + 1e-6).astype(int), 399), 4:]
    path = tmp_path / "fast.csv"
    path.write_text(text_of(head, [[repr(float(cell)) for cell in row] for row in fine]))
    found, slow = read(path, mapping), read(log, mapping)
    assert found.notes[-1].startswith("10 poses each, 1000 Hz")
    assert len(found.t) == 1990
    for k in range(3):
        expected = np.interp(found.t, slow.t, slow.pose[:, k])
        np.testing.assert_allclose(found.pose[:, k], expected, atol=2e-4)


def test_states_may_be_words(files, tmp_path):
    head, rows = rows_of(files[1])
    mapping = changed(files, tmp_path, '"duty"', '"state"')
    ones = [[*row[:4], *(str(int(float(c) > 0)) for c in row[4:])] for row in rows]
    words = [[*row[:4], *(str(float(c) > 0) for c in row[4:])] for row in rows]
    found = []
    for name, table in (("ones.csv", ones), ("words.csv", words)):
        (tmp_path / name).write_text(text_of(head, table))
        found.append(read(tmp_path / name, mapping).inputs.up)
    np.testing.assert_array_equal(*found)


QUATERNION = 'quaternion = ["qx", "qy", "qz", "qw"]'
YUP = 'quaternion = ["QZ", "QX", "QY", "QW"]'  # as docs/calibrate.md has it


@pytest.fixture(scope="module")
def turned(files, tmp_path_factory):
    """A log with quaternions in the place of the heading."""
    head, rows = rows_of(files[1])
    path = tmp_path_factory.mktemp("turned") / "turned.csv"
    half = [0.5 * float(row[3]) for row in rows]
    rows = [
        [*row[:3], "0.0", "0.0", repr(float(np.sin(h))), repr(float(np.cos(h))), *row[4:]]
        for row, h in zip(rows, half, strict=True)
    ]
    path.write_text(text_of([*head[:3], "qx", "qy", "qz", "qw", *head[4:]], rows))
    return path


def changed(files, tmp_path, old, new):
    path = tmp_path / "mapping.toml"
    text = files[0].read_text()
    assert old in text
    path.write_text(text.replace(old, new))
    return path


def test_a_quaternion_is_a_heading(files, tmp_path, turned):
    log = read(turned, changed(files, tmp_path, 'theta = "theta_rad"', QUATERNION))
    np.testing.assert_allclose(log.pose, read(files[1], files[0]).pose, atol=1e-9)


def test_a_quaternion_in_another_order_is_refused(files, tmp_path, turned):
    wrong = QUATERNION.replace('"qx"', '"x_m"')
    with pytest.raises(LogRefusedError, match="the order is x, y, z, w"):
        read(turned, changed(files, tmp_path, 'theta = "theta_rad"', wrong))


def test_an_export_with_y_up_is_read_as_the_page_says(files, tmp_path, turned):
    head, rows = rows_of(turned)
    names = {"x_m": "Z", "y_m": "X", "qx": "QZ", "qy": "QX", "qz": "QY", "qw": "QW"}
    path = tmp_path / "up.csv"
    path.write_text(text_of([names.get(name, name) for name in head], rows))
    mapping = changed(files, tmp_path, 'theta = "theta_rad"', YUP)
    mapping.write_text(mapping.read_text().replace("x_m", "Z").replace("y_m", "X"))
    page = Path(__file__).parents[2] / "docs" / "calibrate.md"
    assert YUP in page.read_text()
    np.testing.assert_allclose(read(path, mapping).pose, read(files[1], files[0]).pose, atol=1e-9)


@pytest.mark.parametrize("order", [(3, 0, 1, 2), (1, 2, 3, 0), (2, 3, 0, 1)])
def test_a_quaternion_of_another_axis_is_refused(files, tmp_path, turned, order):
    names = [QUATERNION.split('"')[1 + 2 * k] for k in order]
    wrong = "quaternion = [" + ", ".join(f'"{name}"' for name in names) + "]"
    with pytest.raises(LogRefusedError, match="turns about z"):
        read(turned, changed(files, tmp_path, 'theta = "theta_rad"', wrong))


def test_a_component_of_a_quaternion_is_no_heading(files, tmp_path, turned, floater):
    log = read(turned, changed(files, tmp_path, '"theta_rad"', '"qz"'))
    assert "quaternion" in [one.name for one in suspicions([log], floater)]


@pytest.mark.parametrize("both", ["", f'theta = "theta_rad"\n{QUATERNION}'])
def test_a_mapping_has_one_kind_of_heading(files, tmp_path, both):
    with pytest.raises(ConfigError, match="either theta or quaternion"):
        load_mapping(str(changed(files, tmp_path, 'theta = "theta_rad"', both)))


@pytest.fixture
def two(files, tmp_path):
    """Rows of two vehicles in turn: a function of their names and of the second's delay."""
    head, rows = rows_of(files[1])

    def write(names, later=0.0):
        found = []
        for row in rows:
            moved = [repr(float(row[0]) + later), repr(float(row[1]) + 1.0), *row[2:]]
            found += [[names[0], *row], [names[1], *moved]]
        path = tmp_path / "two.csv"
        path.write_text(text_of(["body", *head], found))
        return path

    return write


@pytest.mark.parametrize(("names", "value"), [("12", "1"), (("red", "black"), '"red"')])
def test_rows_of_one_vehicle_are_chosen(files, tmp_path, two, names, value):
    mapping = changed(files, tmp_path, "[valves]", f"[rows]\nbody = [{value}]\n[valves]")
    log = read(two(names), mapping)
    np.testing.assert_array_equal(log.pose, read(files[1], files[0]).pose)


def test_two_vehicles_in_one_file_are_named(files, tmp_path, two, floater):
    with pytest.raises(LogRefusedError, match=r"two vehicles: \[rows\]"):
        read(two("12"), files[0])
    log = read(two("12", later=0.02), files[0])
    assert [one.name for one in suspicions([log], floater)] == ["two-vehicles"]
    mapping = changed(files, tmp_path, "[valves]", "[rows]\nbody = [3]\n[valves]")
    with pytest.raises(LogRefusedError, match="rows with one of"):
        read(two("12"), mapping)


def test_of_two_topics_one_must_be_named(files, tmp_path):
    head, rows = rows_of(files[1])
    path = tmp_path / "two.mcap"
    cells = (dict(zip(head, map(float, row), strict=True)) for row in rows)
    write_mcap(path, ["/red", "/black"], ((row["t_s"], row) for row in cells))
    with pytest.raises(LogRefusedError, match="/red, /black"):
        read(path, files[0])
    named = changed(files, tmp_path, "[time]", 'topic = "/red"\n[time]')
    np.testing.assert_allclose(read(path, named).pose, read(files[1], files[0]).pose, atol=1e-9)
    with pytest.raises(LogRefusedError, match="the topics are"):
        read(path, changed(files, tmp_path, "[time]", 'topic = "/blue"\n[time]'))


def test_a_column_of_dates_does_not_hide_decimal_commas(files, tmp_path):
    mapping, log, _ = files
    head, *lines = in_german(text_of(*rows_of(log))).splitlines()
    path = tmp_path / "dated.csv"
    path.write_text("\n".join([f"{head};day", *(f"{line};27.11.2026" for line in lines)]))
    np.testing.assert_array_equal(read(path, mapping).pose, read(log, mapping).pose)


@pytest.mark.parametrize("lost", [["0", "0", "0", "0"], ["inf", "0", "0", "1"]])
def test_a_lost_body_is_no_pose(files, turned, tmp_path, lost):
    mapping = changed(files, tmp_path, 'theta = "theta_rad"', QUATERNION)
    head, rows = rows_of(turned)
    first = head.index("qx")
    for row in rows[10:200:10]:
        row[first : first + 4] = lost
    path = tmp_path / "lost.csv"
    path.write_text(text_of(head, rows))
    assert len(read(turned, mapping).t) - len(read(path, mapping).t) == 19


def test_upper_case_suffixes_are_those_of_a_matlab_file(files, tmp_path):
    mapping, log, _ = files
    head, rows = rows_of(log)
    table = np.array(rows, dtype=float)
    path = tmp_path / "LOG.MAT"
    savemat(path, {name: table[:, k] for k, name in enumerate(head)}, appendmat=False)
    np.testing.assert_array_equal(read(path, mapping).pose, read(log, mapping).pose)


def test_the_times_of_a_labs_mcap_are_its_own_and_it_needs_a_mapping(files, tmp_path):
    mapping, log, _ = files
    path = tmp_path / "lab.mcap"
    head, rows = rows_of(log)
    cells = (dict(zip(head, map(float, row), strict=True)) for row in rows)
    write_mcap(path, ["/state"], ((row.pop("t_s"), row) for row in cells))
    np.testing.assert_allclose(read(path, mapping).t, read(log, mapping).t, atol=1e-6)
    words = ["calibrate", "motion", str(path), "--vehicle", "generic_8jet", "--json"]
    result = CliRunner().invoke(main, words)
    assert result.exit_code == 2
    assert "--mapping" in json.loads(result.stdout)["hint"]
