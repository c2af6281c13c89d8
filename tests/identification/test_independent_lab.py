"""A calibration finds the numbers of vehicles that another simulator flew, within its intervals.

The simulator (`independent_lab`) shares no code with the twin, so an error of the twin's dynamics
that the fit would repeat shows here. Everything goes through the lab's files and the command.
"""

import json

import numpy as np
import pytest
from click.testing import CliRunner

from independent_lab import (
    Lab,
    Robot,
    Written,
    commands,
    flight,
    mapping_of,
    ring,
    true_one,
    vehicle_file,
    write_log,
)
from testbed.cli.main import main

RARE = 1e-3  # chance at which a count of intervals that hold the truth is called too small
SECONDS = 90.0


def drawing(jets, mass, inertia, force, exhaust=600.0):
    """The lab's own numbers of a vehicle."""
    arm = 0.08 + 0.015 * mass**0.5
    return Robot(mass, inertia, (0.0, 0.0), ring(jets, arm, 0.6 * arm, force), 0.01, 0.012, 0.004,
                 0.02, exhaust)  # fmt: skip


# vehicle, rate of the cameras [Hz], form of the log
LABS = (
    (drawing(8, 4.0, 0.03, 0.25, 120.0), 20.0, Written()),  # it loses 4 % of its mass in a flight
    (drawing(9, 9.0, 0.09, 0.4), 30.0, Written("deg", 1e3, 1e3, "us", 1e4, (1.5, -0.5))),
    (drawing(8, 15.0, 0.3, 0.8), 50.0, Written("quaternion", 100.0, start=3.0)),
    (drawing(9, 25.0, 0.6, 1.0), 40.0, Written(second=1e6, start=1.8e9)),
    (drawing(8, 40.0, 1.4, 1.5), 100.0, Written("deg", middle=(0.4, 0.8))),
)


def logged(folder, robot, truth, rate, how, seed, seconds=SECONDS, lively=1.0):
    """What the command says about a flight, and the slope of the table."""
    rng = np.random.default_rng(seed)
    slope = tuple(float(a) for a in rng.uniform(-3e-3, 3e-3, 2))
    lab = Lab(rate, 3e-4, 1e-3, slope, latency=0.01)
    duty, t = commands(truth, lab, seconds, rng, lively), np.arange(0.0, seconds, 1.0 / rate)
    pose = flight(truth, lab, duty, t - lab.latency)
    pose += rng.standard_normal(pose.shape) * [lab.noise, lab.noise, lab.noise_rad]
    write_log(folder / "log.csv", duty, pose, t, how)
    (folder / "lab.toml").write_text(mapping_of(len(robot.jets), lab, how))
    (folder / "drawing.toml").write_text(vehicle_file(robot))
    words = ["motion", "log.csv", "--mapping", "lab.toml", "--vehicle", "drawing.toml", "--json"]
    words = [str(folder / word) if "." in word else word for word in words]
    result = CliRunner().invoke(main, ["calibrate", *words])
    assert result.exit_code == 0, result.output
    return json.loads(result.stdout), slope


@pytest.fixture(scope="module")
def found(tmp_path_factory):
    """Lab, kind, error, low and high minus the true value, of all numbers."""
    rows = []
    for seed, (robot, rate, how) in enumerate(LABS):
        truth = true_one(robot, np.random.default_rng(100 + seed))
        folder = tmp_path_factory.mktemp("lab")
        report, slope = logged(folder, robot, truth, rate, how, seed)
        assert report["findings"] == [], seed
        assert report["suspicions"] == [], seed
        true = {
            "inertia": truth.inertia, "com_x": truth.com[0], "com_y": truth.com[1],
            "delay": truth.opens_s, "slope_x": slope[0], "slope_y": slope[1],
        }  # fmt: skip
        for name, value in true.items():
            row, unit = report["parameters"][name], value if name == "inertia" else 1.0
            ends = (row["value"] - value, row["low"] - value, row["high"] - value)
            rows.append((seed, name.split("_")[0], *(end / unit for end in ends)))
        for row, jet in zip(report["jets"], truth.jets, strict=True):
            ends = (row[key] / jet.force - 1.0 for key in ("thrust_n", "low_n", "high_n"))
            rows.append((seed, "jet", *ends))
    return rows


def fewest(count, chance, rare):
    """The largest k with a binomial chance of fewer than k hits below `rare`."""
    below, k, term = 0.0, 0, (1.0 - chance) ** count
    while below + term < rare:
        below += term
        term *= (count - k) / (k + 1) * chance / (1.0 - chance)
        k += 1
    return k


def test_the_stated_intervals_hold_the_true_numbers(found):
    inside = sum(low <= 0.0 <= high for *_, low, high in found)
    assert len(found) == 72
    assert inside >= fewest(len(found), 0.95, RARE), [row for row in found if row[3] * row[4] > 0.0]


@pytest.mark.parametrize(
    ("kind", "error", "width"),
    [
        ("jet", 0.02, 0.04),
        ("inertia", 0.01, 0.02),
        ("com", 1.2e-3, 2e-3),  # [m]
        ("delay", 3e-3, 4e-3),  # [s]
        ("slope", 1.5e-4, 3e-4),  # [m/s^2]
    ],
)
def test_the_numbers_are_near_the_truth_and_their_intervals_tell_something(
    found, kind, error, width
):
    own = [row[2:] for row in found if row[1] == kind]
    assert max(abs(gap) for gap, _, _ in own) < error
    assert np.median([high - low for _, low, high in own]) < width


@pytest.mark.parametrize("lab", range(len(LABS)))
def test_thrust_over_mass_is_found_while_the_mass_falls(found, lab):
    errors = [row[2] for row in found if row[:2] == (lab, "jet")]
    assert abs(np.mean(errors)) < 6e-3


def test_a_dead_and_a_weak_jet_are_named(tmp_path):
    robot, rate, how = LABS[1]
    jets = list(robot.jets)
    jets[3] = jets[3]._replace(force=1e-6)
    jets[8] = jets[8]._replace(force=0.5 * jets[8].force)
    report, _ = logged(tmp_path, robot, robot._replace(jets=jets), rate, how, 7, 40.0)
    states = {row["jet"]: row["state"] for row in report["jets"] if row["state"] != "ok"}
    assert states == {4: "dead", 9: "weak"}
    assert report["jets"][3]["low_n"] == 0.0
    assert report["jets"][8]["thrust_n"] == pytest.approx(jets[8].force, rel=0.1)


def test_a_log_with_little_motion_says_what_it_does_not_tell(tmp_path):
    robot, rate, how = LABS[0]
    truth = true_one(robot, np.random.default_rng(3))
    report, _ = logged(tmp_path, robot, truth, rate, how, 3, 25.0, lively=0.02)
    assert {"inertia", "com_x", "com_y"} <= set(report["not_identifiable"])
    assert {"inertia", "com_x", "com_y"} <= set(report["kept"])
    assert not any(row["identifiable"] for row in report["jets"])
