"""What the cameras make of a vehicle that a person carries from mark to mark."""

import math

import numpy as np
import pytest

from testbed.commission.cameras import carried, standing
from testbed.core.se2 import wrap
from testbed.identification.table_file import load_table

MARKS = [(0.5, 0.2, 0.0), (0.9, 0.2, 0.0), (0.5, 0.6, 0.0), (0.5, 0.2, math.pi / 2)]
OFF = [(0.01, -0.005, 0.02), (-0.008, 0.01, -0.03), (0.004, 0.006, 0.05), (0.0, -0.01, -0.02)]


def rows(x, y, theta, n=50, noise=0.0002):
    rng = np.random.default_rng(1)
    place = np.tile((0.0, x, y, theta), (n, 1))
    place[:, 0] = 0.01 * np.arange(n)
    place[:, 1:] += noise * rng.standard_normal((n, 3))
    return place


def seen(see):
    return [
        rows(*see(x + dx, y + dy, a + da))
        for (x, y, a), (dx, dy, da) in zip(MARKS, OFF, strict=True)
    ]


def body(dx=0.0, turn=0.0):
    return lambda x, y, a: (x + dx * math.cos(a), y + dx * math.sin(a), wrap(a + turn))


@pytest.mark.parametrize(
    ("see", "code"),
    [
        (body(), ""),
        (body(dx=0.02), ""),
        (body(turn=math.pi / 2), "body_turned"),
        (body(turn=-math.pi / 2), "body_turned"),
        (body(turn=math.pi), "body_turned"),
        (body(dx=0.1), "pivot"),
        (lambda x, y, a: (x + 0.15, y, a), "origin"),
        (lambda x, y, a: (1000.0 * x, 1000.0 * y, a), "units"),
        (lambda x, y, a: (0.001 * x, 0.001 * y, a), "units"),
        (lambda x, y, a: (2.0 * x, 2.0 * y, a), "scale"),
        (lambda x, y, a: (y, -x, a - math.pi / 2), "frame_turned"),
        (lambda x, y, a: (-x, -y, a + math.pi), "frame_turned"),
        (lambda x, y, a: (x, -y, -a), "frame_mirrored"),
        (lambda x, y, a: (y, x, math.pi / 2 - a), "frame_mirrored"),
        (lambda x, y, a: (x, 0.1, 0.0), "up_axis"),
        (lambda x, y, a: (x, y, 0.0), "up_axis"),
        (lambda x, y, a: (0.3, 0.2, 0.1), "wrong_body"),
    ],
)
def test_axes_units_and_body(see, code):
    verdict = carried("sat1", MARKS, {"sat1": seen(see)})
    assert verdict.code == code, verdict.text


def test_the_bodies_of_two_vehicles_are_exchanged():
    still = [rows(-1.0, 0.0, 0.0)] * 4
    verdict = carried("sat1", MARKS, {"sat1": still, "sat2": seen(body())})
    assert verdict.code == "bodies_swapped"
    assert "sat2" in verdict.text


@pytest.mark.parametrize(
    ("found", "code"),
    [
        (rows(0.1, 0.2, 0.0, n=200), ""),
        (rows(0.1, 0.2, 0.0, n=100), "camera_rate"),
        (rows(0.1, 0.2, 0.0, n=3), "no_poses"),
        (rows(0.1, 0.2, 0.0, n=200, noise=0.0), "camera_frozen"),
        (rows(0.1, 0.2, 0.0, n=200, noise=0.005), "camera_noise"),
        (rows(300.0, 0.2, 0.0, n=200), "units"),
    ],
)
def test_standing_bodies(found, code):
    verdict = standing("sat1", found, 2.0, load_table("marble_6m"))
    assert verdict.code == code, verdict.text
