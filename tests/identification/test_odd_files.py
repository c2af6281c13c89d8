"""Logs as labs write them: other marks, other encodings, quaternions, two vehicles in one file."""

import csv
import gzip
import json

import numpy as np
import pytest
from click.testing import CliRunner
from scipy.io import savemat

from lab_mcap import write_mcap
from testbed.cli.main import main
from testbed.config import ConfigError
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
        (b"", "no such column"),
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


QUATERNION = 'quaternion = ["qx", "qy", "qz", "qw"]'


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
