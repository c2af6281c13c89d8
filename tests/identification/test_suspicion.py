"""A log that is not what its mapping says is refused, and the reason is named."""

import numpy as np
import pytest

from testbed.config import ConfigError
from testbed.core.error import TestbedError
from testbed.identification.columns import LogRefusedError
from testbed.identification.mapping import load_mapping
from testbed.identification.motion import calibrate_motion
from testbed.identification.motion_log import read_motion_log
from testbed.identification.suspicion import suspicions


def names(log, vehicle):
    return [one.name for one in suspicions([log], vehicle)]


def test_a_good_log_is_not_suspected(flight, floater):
    assert names(flight[1], floater) == []


@pytest.mark.parametrize(
    ("change", "name"),
    [
        (lambda p: p[:, [1, 0, 2]], "axes-swapped"),
        (lambda p: p * [-1, 1, 1], "mirrored-x"),
        (lambda p: p * [1, -1, 1], "mirrored-y"),
        (lambda p: p * [-1, -1, 1], "signs-turned"),
        (lambda p: p * [1, 1, -1], "heading-sign"),
        (lambda p: np.add(p, [0, 0, np.pi / 2]), "frame-turned"),
        (lambda p: p * [1, 1, 180 / np.pi], "unit-angle"),
        (lambda p: p * [1, 1, np.pi / 180], "unit-angle"),
        (lambda p: p * [1000, 1000, 1], "unit-position"),
        (lambda p: p * [100, 100, 1], "unit-position"),
        (lambda p: 0.0 * p, "no-motion"),
        (lambda p: p * [0, 1, 1], "no-motion"),
        (lambda p: p * [1, 0, 1], "no-motion"),
        (lambda p: p * [1, 1, 0], "no-motion"),
        (lambda p: np.roll(p, 400, axis=0), "unexplained"),
    ],
)
def test_a_changed_pose_is_named(flight, floater, change, name):
    assert name in names(flight[1]._replace(pose=change(flight[1].pose)), floater)


@pytest.mark.parametrize(
    ("factor", "words"),
    [(1e3, "mm read"), (1e2, "cm read"), (39.37, "inches read"), (1e-3, "as mm")],
)
def test_the_unit_of_a_length_is_named(flight, floater, factor, words):
    (found,) = suspicions([flight[1]._replace(pose=flight[1].pose * [factor, factor, 1])], floater)
    assert found.name == "unit-position"
    assert words in found.text or "in mm?" in found.text


@pytest.mark.parametrize("turned", [10.0, -10.0])
def test_a_body_that_is_turned_in_motion_capture_is_a_warning(flight, floater, turned):
    log = flight[1]._replace(pose=np.add(flight[1].pose, [0, 0, np.radians(turned)]))
    (found,) = suspicions([log], floater)
    assert (found.name, found.refuses) == ("heading-off", False)
    said = float(found.text.split(" deg aside")[0].split()[-1])
    assert said == pytest.approx(-turned, abs=2.0)


def test_commands_that_are_late_by_a_clock_are_a_warning(flight, floater):
    log = flight[1]
    later = log._replace(t=log.t + 0.3)
    found = calibrate_motion([later], floater)
    assert "long-delay" in [one.name for one in found.suspicions]
    assert "long-delay" not in [one.name for one in calibrate_motion([log], floater).suspicions]


def read(path, mapping):
    return read_motion_log(path, load_mapping(str(mapping)))


def test_a_file_is_read_as_it_was_written(files, flight):
    mapping, path, _ = files
    log = read(path, mapping)
    np.testing.assert_allclose(log.pose, flight[1].pose, atol=1e-9)
    np.testing.assert_allclose(log.inputs.up, flight[1].inputs.up, atol=1e-6)
    np.testing.assert_allclose(log.inputs.down, flight[1].inputs.down, atol=1e-6)


def jump(rows):
    for row in rows[600:]:
        row[0] -= 3.0
    return rows


def scaled(column, factor):
    def change(rows):
        for row in rows:
            row[column] *= factor
        return rows

    return change


def written(column, text):
    def change(rows):
        rows[7][column] = text
        return rows

    return change


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (jump, "clock jump"),
        (scaled(0, 1000.0), "unit of time"),
        (scaled(5, 100.0), "percent"),
        (written(1, "1,234.5"), "thousands separators"),
        (written(1, "0,5"), "decimal comma"),
        (written(1, "broken"), "expected  a number"),
        (written(5, ""), "a number in every row of 'duty_2'"),
        (lambda rows: rows[:15], "20 rows"),
        (lambda rows: [row[:-1] if k == 9 else row for k, row in enumerate(rows)], "data row 10"),
    ],
)
def test_a_broken_file_is_refused(files, change, words):
    mapping, _, write = files
    with pytest.raises(LogRefusedError, match=words):
        read(write("broken.csv", change=change), mapping)


def test_a_missing_column_is_named(files):
    mapping, _, write = files
    head = ["t_s", "x_m", "y_m", "yaw_rad", *(f"duty_{k + 1}" for k in range(8))]
    with pytest.raises(LogRefusedError, match="theta_rad"):
        read(write("renamed.csv", head=head), mapping)


def test_a_gap_is_noted_and_not_crossed(files):
    mapping, _, write = files
    log = read(write("gap.csv", change=lambda rows: rows[:300] + rows[340:]), mapping)
    assert len(log.notes) == 1
    assert log.notes[0].startswith("gap: 2.05 s")


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('kind = "duty"', 'kind = "shares"', "one of: duty, state, us"),
        ('x = "x_m"', "", "pose.x"),
        ("[valves]", "[valve]", "valve"),
        ("period_s = 0.1", "period_s = -1.0", "> 0"),
    ],
)
def test_a_broken_mapping_is_refused(files, tmp_path, old, new, words):
    path = tmp_path / "bad.toml"
    text = files[0].read_text()
    assert old in text
    path.write_text(text.replace(old, new))
    with pytest.raises(ConfigError, match=words):
        load_mapping(str(path))


def test_a_mapping_has_one_kind_of_input(tmp_path):
    path = tmp_path / "none.toml"
    path.write_text('[time]\ncolumn = "t"\n[pose]\nx = "x"\ny = "y"\ntheta = "q"\n')
    with pytest.raises(TestbedError, match="neither"):
        load_mapping(str(path))


@pytest.mark.parametrize("name", ["uky", "spot", "ita"])
def test_the_mappings_of_the_labs_are_shipped(name):
    assert load_mapping(name).name
