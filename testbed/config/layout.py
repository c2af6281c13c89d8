"""Validates names, the table, and the places of vehicles, goals and obstacles."""

import math
import re
from collections.abc import Iterator
from itertools import chain, combinations

from testbed.config.error import Violation, show
from testbed.config.experiment import Experiment, VehicleSetup
from testbed.core.path import Path
from testbed.core.table import Obstacle, Table
from testbed.core.vehicle import Point

TAKEN = ("host", "operator", "table", "truth")  # reserved names on the network and in the log
LARGEST_TABLE = 100.0  # [m]
STEEPEST = 1.0  # tilt, 6 degrees [m/s^2]
PATH_LOOKS = 1000


def bad_layout(experiment: Experiment) -> Iterator[Violation]:
    """Errors in names and places."""
    yield from _names(experiment)
    yield from _ground(experiment.table)
    for name, obstacle in experiment.obstacles.items():
        if obstacle.solid > obstacle.radius:
            expected = f"at most the danger radius, {obstacle.radius:g} m"
            yield Violation(("obstacles", name, "solid"), expected, f"{obstacle.solid:g} m")
    for name, setup in experiment.vehicles.items():
        yield from _poses(name, setup, experiment)
    yield from _neighbours(experiment)


def _names(experiment: Experiment) -> Iterator[Violation]:
    """A name becomes part of a file name, of a log's topic and of a key on the network."""
    if not re.fullmatch(r"[A-Za-z0-9][\w.-]{0,63}", experiment.name, re.ASCII):
        expected = "at most 64 letters, digits, `_`, `-`, `.`, the first a letter or digit"
        yield Violation(("name",), expected, show(experiment.name))
    if not experiment.vehicles:
        yield Violation(("vehicles",), "at least one vehicle", "none")
    named = [("vehicles", n) for n in experiment.vehicles]
    for key in chain(named, (("obstacles", n) for n in experiment.obstacles)):
        if not re.fullmatch(r"[\w-]{1,32}", key[1], re.ASCII):
            yield Violation(key, "a name of at most 32 letters, digits, `_`, `-`", show(key[1]))
        elif key[1][0] == "-":  # `testbed agent -h` asks for help
            yield Violation(key, "a name that begins with a letter, a digit or `_`", show(key[1]))
        if key[1] in TAKEN:
            yield Violation(key, f"a name that is not one of: {', '.join(TAKEN)}", show(key[1]))
    for name in experiment.obstacles:
        if name in experiment.vehicles:
            yield Violation(("obstacles", name), "a name that no vehicle has", show(name))


def _ground(table: Table) -> Iterator[Violation]:
    for axis, length in enumerate(table.size):
        if length > LARGEST_TABLE:
            expected = f"metres, at most {LARGEST_TABLE:g}"
            yield Violation(("table", "size", axis), expected, f"{length:g}")
    key, grid = ("table", "tilt", "map"), table.tilt.map
    columns = {len(row) for row in grid}
    if len(columns) > 1:
        yield Violation(key, "rows of equal length", f"lengths {sorted(columns)}")
    elif grid and (len(grid) < 2 or min(columns) < 2):
        expected = "at least 2 rows of 2 nodes, from edge to edge of the table"
        yield Violation(key, expected, f"{len(grid)} x {min(columns)}")
    nodes = [
        (("table", "tilt", "uniform"), table.tilt.uniform),
        *(((*key, j, i), node) for j, row in enumerate(grid) for i, node in enumerate(row)),
    ]
    for where, slope in nodes:
        if math.hypot(*slope) > STEEPEST:
            expected = f"m/s^2, at most {STEEPEST:g}: a slope of 6 degrees"
            yield Violation(where, expected, f"{math.hypot(*slope):g}")


def _poses(name: str, setup: VehicleSetup, experiment: Experiment) -> Iterator[Violation]:
    size, radius = experiment.table.size, setup.model.radius
    rim = radius + experiment.flight.gate.fence_margin
    half_x, half_y = size[0] / 2 - rim, size[1] / 2 - rim
    if min(half_x, half_y) < 0.0:
        expected = f"a vehicle that fits on the table of {size[0]:g} m x {size[1]:g} m"
        yield Violation(("vehicles", name, "model", "radius"), expected, f"{radius:g} m")
    if setup.path is not None:
        yield from _path(name, setup.goal, setup.path, experiment.duration_s, (half_x, half_y))
    for which, pose in (("start", setup.start), ("goal", setup.goal)):
        key = ("vehicles", name, which)
        if abs(pose[0]) > half_x or abs(pose[1]) > half_y:
            room = f"a place on the table, |x| <= {half_x:g} m and |y| <= {half_y:g} m"
            yield Violation(key, room, f"({pose[0]:g}, {pose[1]:g})")
        if abs(pose[2]) > 2.0 * math.pi:
            yield Violation((*key, 2), "a heading in radians, at most 2 pi", f"{pose[2]:g}")
        for other, obstacle in experiment.obstacles.items():
            if which == "start" or obstacle.velocity == (0.0, 0.0):
                yield from _inside(key, pose, radius, other, obstacle)


def _path(
    name: str, goal: tuple[float, ...], path: Path, duration: float, half: Point
) -> Iterator[Violation]:
    """A goal's path must stay on the table; checked at PATH_LOOKS + 1 times."""
    for k in range(PATH_LOOKS + 1):
        t = k * duration / PATH_LOOKS
        x, y = (a + b for a, b in zip(goal[:2], path.at(t).p, strict=True))
        if abs(x) > half[0] or abs(y) > half[1]:
            room = f"a path on the table, |x| <= {half[0]:g} m and |y| <= {half[1]:g} m"
            yield Violation(("vehicles", name, "path"), room, f"({x:.3f}, {y:.3f}) after {t:.1f} s")
            return


def _inside(
    key: tuple[str, ...], pose: tuple[float, ...], radius: float, name: str, obstacle: Obstacle
) -> Iterator[Violation]:
    gap, need = (
        math.dist(pose[:2], obstacle.position),
        max(obstacle.radius, obstacle.solid + radius),
    )
    if gap < need:
        expected = f"outside obstacle {name}, at least {need:g} m from its centre"
        yield Violation(key, expected, f"{gap:.3f} m")


def _neighbours(experiment: Experiment) -> Iterator[Violation]:
    for (a, one), (b, two) in combinations(experiment.vehicles.items(), 2):
        need = one.model.radius + two.model.radius
        for which in ("start", "goal"):
            gap = math.dist(getattr(one, which)[:2], getattr(two, which)[:2])
            if gap < need:
                expected = f"at least {need:g} m from {a}'s {which}"
                yield Violation(("vehicles", b, which), expected, f"{gap:.3f} m: they overlap")
