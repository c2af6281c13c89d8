"""gao2022, Table 3: L of formations that are as uniform as possible, without a simulation.

Curves: equal arcs. Areas and solids: the densest lattice (hexagonal, face-centred cubic), cut to
contain the exact number of points, with the centre and direction that give the largest L.
Surfaces: a Fibonacci spiral around the axis that gives the largest L, and points that repel each
other until they rest.
"""

from collections.abc import Iterator

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray
from scipy.spatial.distance import pdist
from scipy.spatial.transform import Rotation

from testbed.metrics.characterisation import characterise, ring_uniformity
from testbed.reproduction.figure import Figure
from testbed.reproduction.targets import Measures

Array = NDArray[np.float64]

REACH = 6.0  # of the lattice [spacings]
SHIFTS = 12  # of the centre along each edge of the lattice's cell
TURNED_SHIFTS = {2: 12, 3: 4}  # the same for each rotation of the lattice
TURNS = {2: 24, 3: 200}  # number of rotations of the lattice
PUSHES = 400  # iterations of the repulsion on a surface
DENSEST = float(np.pi / np.sqrt(18.0))  # density of the densest packing of balls (Hales 2005)


class Layouts(Struct, frozen=True, forbid_unknown_fields=True, tag="layouts"):
    """Parameters of the formations; defaults are those of Table 3."""

    count: int = 50
    corrections: tuple[str, ...] = ()
    assumptions: tuple[str, ...] = ()


def ellipse(count: int, a: float, b: float) -> Array:
    """Points at equal arcs of an ellipse, (count, 2)."""
    angle = np.linspace(0.0, 2.0 * np.pi, 100_001)
    x = np.c_[a * np.cos(angle), b * np.sin(angle)]
    way = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(x, axis=0), axis=1))])
    at = np.arange(count) * way[-1] / count
    return np.c_[np.interp(at, way, x[:, 0]), np.interp(at, way, x[:, 1])]


def double_circle(count: int, inner: float, outer: float) -> Array:
    """Points on two circles with the same spacing on both."""
    few = round(count * inner / (inner + outer))
    return np.concatenate([ellipse(few, inner, inner), ellipse(count - few, outer, outer)])


def lattice(d: int) -> tuple[Array, Array]:
    """Points of the densest lattice with spacing 1, and its basis as rows."""
    n = np.arange(-9, 10)
    if d == 2:
        basis = np.array([[1.0, 0.0], [0.5, np.sqrt(0.75)]])
    else:
        basis = np.array([[1.0, 1.0, 0.0], [1.0, 0.0, 1.0], [0.0, 1.0, 1.0]]) / np.sqrt(2.0)
    grid = np.stack(np.meshgrid(*[n] * d, indexing="ij"), axis=-1).reshape(-1, d)
    points = grid @ basis
    return points[np.linalg.norm(points, axis=1) < REACH], basis


def turns(d: int) -> Iterator[Array]:
    """Rotations of the lattice, the first one the identity."""
    yield np.eye(d)
    if d == 2:
        for angle in np.linspace(0.0, np.pi / 3.0, TURNS[d], endpoint=False)[1:]:
            c, s = np.cos(angle), np.sin(angle)
            yield np.array([[c, -s], [s, c]])
    else:
        yield from Rotation.from_quat(
            np.random.default_rng(0).normal(size=(TURNS[d], 4))
        ).as_matrix()  # uniformly random


def cuts(count: int, axes: Array) -> Iterator[Array]:
    """Cuts of the lattice by an ellipse or ellipsoid that hold exactly `count`."""
    d = len(axes)
    points, basis = lattice(d)
    round_ = bool(np.ptp(axes) == 0.0)
    shifts = SHIFTS if round_ else TURNED_SHIFTS[d]
    share = np.arange(shifts) / shifts
    centres = np.stack(np.meshgrid(*[share] * d, indexing="ij"), axis=-1).reshape(-1, d) @ basis
    for turn in [np.eye(d)] if round_ else turns(d):
        turned = points @ turn.T
        for centre in centres @ turn.T:
            x = turned - centre
            size = ((x / axes) ** 2).sum(axis=1)
            inner = np.argpartition(size, [count - 1, count])
            if size[inner[count]] - size[inner[count - 1]] > 1e-9:  # else both are on the cut
                yield x[inner[:count]]


def densest(count: int, axes: tuple[float, ...]) -> float | None:
    """Largest L of such a cut, over its smallest extent; None if there is no cut."""
    best = min(cuts(count, np.array(axes)), key=lambda x: float(pdist(x).max()), default=None)
    return None if best is None else characterise(best).uniformity


def spiral(count: int) -> Array:
    """Points on a unit sphere along a Fibonacci spiral round the last axis, (count, 3)."""
    k = np.arange(count) + 0.5
    z, angle = 1.0 - 2.0 * k / count, np.pi * (1.0 + np.sqrt(5.0)) * k
    return np.c_[np.sqrt(1.0 - z * z) * np.cos(angle), np.sqrt(1.0 - z * z) * np.sin(angle), z]


def spirals(count: int, axes: tuple[float, float, float]) -> Iterator[Array]:
    """Fibonacci spirals on an ellipsoid, around each of its axes."""
    for turn in range(3):
        yield np.roll(spiral(count), turn, axis=1) * np.array(axes)


def rested(count: int, axes: tuple[float, float, float]) -> Array:
    """Points on an ellipsoid after mutual repulsion, (count, 3)."""
    shape = np.array(axes)
    x = spiral(count) * shape
    for push in range(PUSHES):
        gap = x[:, None] - x[None]
        d2 = (gap**2).sum(axis=2) + np.eye(count)
        force = (gap / d2[:, :, None] ** 4).sum(axis=1)
        step = 0.05 * (1.0 - push / PUSHES) * np.sqrt(d2.min())
        x = x + step * force / np.linalg.norm(force, axis=1).max()
        x = x / np.sqrt(((x / shape) ** 2).sum(axis=1))[:, None]
    return x


def run_layouts(run: Layouts, *, quick: bool) -> tuple[Measures, list[Figure]]:
    """L of the nine formations, and of a ring in closed form; deterministic."""
    n = run.count

    def even(x: Array) -> float:
        return characterise(x).uniformity or 0.0

    found: dict[str, float | None] = {
        "ellipse": even(ellipse(n, 1.0, 0.6)),
        "circle": even(ellipse(n, 1.0, 1.0)),
        "double_circle": even(double_circle(n, 0.4, 1.0)),
        "ellipse_disk": densest(n, (1.0, 0.5)),
        "ellipse_disk_wide": densest(n, (1.0, 0.6)),
        "disk": densest(n, (1.0, 1.0)),
        "ellipsoid_surface": max(map(even, spirals(n, (1.0, 0.8, 0.6)))),
        "sphere_surface": even(spiral(n)),
        "ellipsoid_surface_rested": even(rested(n, (1.0, 0.8, 0.6))),
        "sphere_surface_rested": even(rested(n, (1.0, 1.0, 1.0))),
        "ellipsoid_space": densest(n, (1.0, 0.8, 0.6)),
        "sphere_space": densest(n, (1.0, 1.0, 1.0)),
        "equation_28_printed": n * (np.pi / (n + 2.0 * np.pi)) ** 3,
        "equation_28": ring_uniformity(n),
        "densest_packing": DENSEST,
    }

    def of(*names: str) -> list[float]:
        return [value for name in names if (value := found[name]) is not None]

    plane = of("ellipse", "circle", "double_circle", "ellipse_disk", "disk")
    space = of("ellipsoid_surface", "sphere_surface", "ellipsoid_space", "sphere_space")
    found["space_over_plane"] = min(space) / max(plane)
    lines, areas = of("ellipse", "circle", "double_circle"), of("ellipse_disk", "disk")
    found["area_over_line"] = min(areas) / max(lines)
    found["two_over_one"] = min(of("double_circle")) / max(of("circle", "ellipse"))
    return {name: [value] for name, value in found.items()}, []
