"""gao2022, Table 3: L of formations that are as even as they get, without a simulation.

Curves: equal arcs. Areas and solids: the densest lattice (hexagonal, face-centred cubic), cut so
that exactly so many are inside, from the centre and size that give the largest L. Surfaces: points
on a Fibonacci spiral that push each other apart until they rest.
"""

from collections.abc import Iterator

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from testbed.metrics.characterisation import characterise, ring_uniformity
from testbed.reproduction.figure import Figure
from testbed.reproduction.targets import Measures

Array = NDArray[np.float64]

SIZES = 400  # of a lattice are tried
PUSHES = 400  # of the points of a surface
DENSEST = np.pi / np.sqrt(18.0)  # share of space that equal balls can fill (Hales 2005)


class Layouts(Struct, frozen=True, forbid_unknown_fields=True, tag="layouts"):
    """Which; the numbers are Table 3's."""

    count: int = 50
    corrections: tuple[str, ...] = ()
    assumptions: tuple[str, ...] = ()


def ellipse(count: int, a: float, b: float) -> Array:
    """Equal arcs, (count, 2)."""
    angle = np.linspace(0.0, 2.0 * np.pi, 100_001)
    x = np.c_[a * np.cos(angle), b * np.sin(angle)]
    way = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(x, axis=0), axis=1))])
    at = np.arange(count) * way[-1] / count
    return np.c_[np.interp(at, way, x[:, 0]), np.interp(at, way, x[:, 1])]


def double_circle(count: int, inner: float, outer: float) -> Array:
    """As many on each as give the same spacing."""
    few = round(count * inner / (inner + outer))
    return np.concatenate([ellipse(few, inner, inner), ellipse(count - few, outer, outer)])


def lattice(d: int) -> tuple[Array, tuple[Array, ...]]:
    """Points of the densest lattice with spacing 1, and centres to cut from."""
    n = np.arange(-9, 10)
    if d == 2:
        basis = np.array([[1.0, 0.0], [0.5, np.sqrt(0.75)]])
    else:
        basis = np.array([[1.0, 1.0, 0.0], [1.0, 0.0, 1.0], [0.0, 1.0, 1.0]]) / np.sqrt(2.0)
    grid = np.stack(np.meshgrid(*[n] * d, indexing="ij"), axis=-1).reshape(-1, d)
    shares = [(0.0,) * d, (0.5,) + (0.0,) * (d - 1), (1.0 / 3.0,) * d, (0.25,) * d, (0.5,) * d]
    return grid @ basis, tuple(np.array(share) @ basis for share in shares)


def cuts(count: int, axes: Array) -> Iterator[Array]:
    """Cuts of the lattice by an ellipse or ellipsoid that hold exactly `count`."""
    points, centres = lattice(len(axes))
    for centre in centres:
        for size in np.linspace(2.0, 6.5, SIZES):
            x = (points - centre) / size
            inside = x[((x / axes) ** 2).sum(axis=1) <= 1.0]
            if len(inside) == count:
                yield inside


def densest(count: int, axes: tuple[float, ...]) -> float | None:
    """Largest L of such a cut; null if there is none."""
    found = [characterise(x).uniformity or 0.0 for x in cuts(count, np.array(axes))]
    return max(found) if found else None


def surface(count: int, axes: tuple[float, float, float]) -> Array:
    """Points on an ellipsoid that have pushed each other apart, (count, 3)."""
    k = np.arange(count) + 0.5
    z, angle = 1.0 - 2.0 * k / count, np.pi * (1.0 + np.sqrt(5.0)) * k
    x = np.c_[np.sqrt(1.0 - z * z) * np.cos(angle), np.sqrt(1.0 - z * z) * np.sin(angle), z]
    shape = np.array(axes)
    x = x * shape
    for push in range(PUSHES):
        gap = x[:, None] - x[None]
        d2 = (gap**2).sum(axis=2) + np.eye(count)
        force = (gap / d2[:, :, None] ** 4).sum(axis=1)
        step = 0.05 * (1.0 - push / PUSHES) * np.sqrt(d2.min())
        x = x + step * force / np.linalg.norm(force, axis=1).max()
        x = x / np.sqrt(((x / shape) ** 2).sum(axis=1))[:, None]
    return x


def run_layouts(run: Layouts, *, quick: bool) -> tuple[Measures, list[Figure]]:
    """L of the nine formations, and of a ring by the closed forms; nothing is random."""
    n = run.count

    def even(x: Array) -> float:
        return characterise(x).uniformity or 0.0

    found: dict[str, float | None] = {
        "ellipse": even(ellipse(n, 1.0, 0.6)),
        "circle": even(ellipse(n, 1.0, 1.0)),
        "double_circle": even(double_circle(n, 0.4, 1.0)),
        "ellipse_disk": densest(n, (1.0, 0.6)),
        "ellipse_disk_as_printed": densest(n, (1.0, 0.5)),
        "disk": densest(n, (1.0, 1.0)),
        "ellipsoid_surface": even(surface(n, (1.0, 0.8, 0.6))),
        "sphere_surface": even(surface(n, (1.0, 1.0, 1.0))),
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
