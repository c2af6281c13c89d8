"""Synthetic flights with known numbers."""

import csv

import numpy as np
import pytest

from testbed.identification.synthetic import drawn, excitation, flown_log
from testbed.identification.table_file import load_table
from testbed.identification.vehicle_file import load_vehicle


@pytest.fixture(scope="session")
def floater():
    return load_vehicle("generic_8jet")


@pytest.fixture(scope="session")
def flight(floater):
    """A true vehicle and its log: 60 s of random pulses on a level table."""
    rng = np.random.default_rng(5)
    truth = drawn(floater, rng)
    return truth, flown_log(truth, None, excitation(truth, 60.0, 0.1, rng), 60.0, rng)


@pytest.fixture(scope="session")
def table():
    return load_table("marble_6m")


def rows_of(log, jets=8):
    """The log as rows of a CSV: 20 Hz poses, duty cycles of 0.1 s periods."""
    share = np.zeros((round(log.t[-1] / 0.1) + 2, jets))
    for up, down, jet in zip(*log.inputs[:3], strict=True):
        first = round(up / 0.1)
        for k in range(first, len(share)):
            part = min(down, 0.1 * (k + 1)) - max(up, 0.1 * k)
            if part <= 1e-9:
                break
            share[k, jet] += part / 0.1
    names = ["t_s", "x_m", "y_m", "theta_rad", *(f"duty_{k + 1}" for k in range(jets))]
    return names, [
        [t, *pose, *np.minimum(share[int(t / 0.1 + 1e-6)], 1.0)]
        for t, pose in zip(log.t, log.pose, strict=True)
    ]


MAPPING = """
[time]
column = "t_s"
[pose]
x = "x_m"
y = "y_m"
theta = "theta_rad"
[valves]
columns = ["duty_1", "duty_2", "duty_3", "duty_4", "duty_5", "duty_6", "duty_7", "duty_8"]
period_s = 0.1
kind = "duty"
"""


@pytest.fixture(scope="session")
def files(flight, tmp_path_factory):
    """A mapping file, a CSV, and a function that writes a changed CSV."""
    folder = tmp_path_factory.mktemp("lab")
    mapping = folder / "lab.toml"
    mapping.write_text(MAPPING)
    names, rows = rows_of(flight[1])

    def write(name, head=None, change=None):
        path = folder / name
        with path.open("w", newline="") as file:
            writer = csv.writer(file)
            writer.writerow(head or names)
            writer.writerows(change([list(row) for row in rows]) if change else rows)
        return path

    return mapping, write("log.csv"), write
