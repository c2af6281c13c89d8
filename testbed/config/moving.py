"""Validates the path of a goal: its points, and whether the vehicle can follow it."""

import math
from collections.abc import Iterator, Sequence
from itertools import pairwise

from testbed.config.error import Violation, show
from testbed.config.experiment import Experiment, VehicleSetup
from testbed.config.fit import weakest_torque
from testbed.core.path import Path, Points, along
from testbed.core.vehicle import Point
from testbed.flight.allocation import weakest_force

LOOKS = 1000
APART = 1e-3  # smallest distance of successive points [m]


def bad_paths(experiment: Experiment) -> Iterator[Violation]:
    """Errors in the paths of goals; the vehicles are valid, and defaults are filled in."""
    for name, setup in experiment.vehicles.items():
        if setup.path is None:
            continue
        key = ("vehicles", name, "path")
        if isinstance(setup.path, Points):
            yield from _points(key, setup.path.points)
        yield from _speed(key, setup, setup.path, experiment)


def _points(key: tuple[str, ...], points: Sequence[Point]) -> Iterator[Violation]:
    for k, (before, point) in enumerate(pairwise([(0.0, 0.0), *points])):
        if math.dist(before, point) < APART:
            what = f"point {k}" if k else "the goal, (0, 0), where the path begins"
            expected = f"a point at least {1e3 * APART:g} mm from {what}"
            yield Violation((*key, "points", k), expected, show(list(point)))


def _speed(
    key: tuple[str, ...], setup: VehicleSetup, path: Path, experiment: Experiment
) -> Iterator[Violation]:
    """Looked at LOOKS + 1 times of the run."""
    model, barrier, led = setup.model, experiment.flight.barrier, along(path)
    accel, spin = weakest_force(model) / model.mass, weakest_torque(model) / model.inertia
    for k in range(LOOKS + 1):
        t = k * experiment.duration_s / LOOKS
        moved = path.at(t)
        speed, push = math.hypot(*moved.v), math.hypot(*moved.a)
        turn = 0.0 if led is None else abs(led.tangent(t)[2])
        for what, unit, asked, most in (
            ("no faster than flight.barrier.max_speed,", "m/s", speed,
             barrier.max_speed if barrier.on else math.inf),
            ("that the jets can follow: at most", "m/s^2", push, accel),
            ("along which the jets can turn: at most", "rad/s^2", turn, spin),
        ):  # fmt: skip
            if asked > most:
                expected = f"a path {what} {most:.3g} {unit}"
                yield Violation(key, expected, f"{asked:.3g} {unit} after {t:.1f} s")
                return
