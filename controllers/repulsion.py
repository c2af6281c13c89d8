r"""Short-range repulsion between many satellites, in 2-D and 3-D, without an N x N array.

Source: Eq. (12), (13) of W. Gao, K. Li, C. Wei, "Satellite Cluster Formation Reconfiguration Based
on the Bifurcating Potential Field", Aerospace 9:137, 2022.

    U_ij = (k_c / 2) (s - d)^2                 for d < s, else 0                    Eq. (12)
    F_ij = k_c (s / d - 1) (x_i - x_j)         for d < s, else 0                    Eq. (13)

    paper        code         meaning                                        unit
    x_i          x            positions, shape (n, 2) or (n, 3)              m
    d            d            distance of i and j                            m
    s            reach        range of the repulsion                         m
    k_c          stiffness                                                   N/m

Differences from the paper: its Eq. (13) has the opposite sign, which attracts at every d < s, and
its Eq. (12) is not a primitive of it; the equations above reproduce its figures. For two satellites
at the same position (d = 0) the direction is undefined and the force zero. A satellite whose
position is not finite gets a force of nan and pushes no other.

Three algorithms compute the same sum and differ in rounding only:

    `pairs`   visits every pair once: the fastest for some hundreds of satellites
    `rows`    visits all others for every satellite: for many satellites, all within reach
    `cells`   visits the satellite's own and the neighbouring cells of a grid of width s
              (controllers/repulsion_cells.py): O(n) while few satellites are within s

The last two have multi-threaded versions. They, too, sum the neighbours of each satellite in the
order of storage, so the result is bit-identical for any number of threads.
"""

import numpy as np
from numba import prange
from numpy.typing import ArrayLike, NDArray

from controllers.repulsion_cells import (
    CHUNK,
    cells,
    cells_on_all_cores,
    extent_of,
    on_all_cores,
)
from testbed.core.compiled import compiled  # also sets numba's cache directory

Array = NDArray[np.float64]

FEW = 256  # satellites up to which `pairs` is the fastest
MANY_ROWS, MANY_CELLS = 2048, 16384  # satellites from which threads pay
LANES = 64  # partial sums, so that the sum can be vectorised in a fixed order
CROWDED = 0.3  # share of all pairs in neighbouring cells above which `rows` beats `cells`
NOWHERE = 1e300  # [m] finite, but out of reach of every satellite


def repulsion(x: ArrayLike, stiffness: float, reach: float) -> Array:
    """Force on each satellite, shape (n, d) [N], by the fastest of the three algorithms.

    Args:
        x: positions, shape (n, 2) or (n, 3) [m].
        stiffness: k_c [N/m].
        reach: s [m].

    Raises:
        ValueError: wrong shapes, or parameters that are not finite or negative.
    """
    places = np.ascontiguousarray(x, dtype=np.float64)
    if places.ndim != 2 or places.shape[1] not in (2, 3):
        raise ValueError(f"expected positions of shape (n, 2) or (n, 3), found {places.shape}")
    if not (0.0 <= reach < np.inf and np.isfinite(stiffness)):
        raise ValueError(
            f"expected a finite reach >= 0 [m] and a finite stiffness [N/m], "
            f"found reach = {reach}, stiffness = {stiffness}"
        )
    force = np.zeros_like(places)
    if len(places) <= FEW:
        way = pairs
    elif reach == 0.0 or nearby_share(places, reach) < CROWDED:
        way = cells_on_all_cores if len(places) >= MANY_CELLS else cells
    else:
        way = rows_on_all_cores if len(places) >= MANY_ROWS else rows
    way(stiffness, reach, places, force)
    return force


@compiled
def nearby_share(x, reach):
    """Share of all pairs in neighbouring cells, for a uniform density in the bounding box."""
    share = 1.0
    for a in range(x.shape[1]):
        extent = extent_of(x, a)
        if extent > 3.0 * reach:
            share *= 3.0 * reach / extent
    return share


@compiled
def pairs(stiffness, reach, x, force):
    """Write the forces [N], visiting every pair once; allocates nothing, so laws can call it."""
    n, d = x.shape
    for i in range(n):
        for a in range(d):
            force[i, a] = x[i, a] - x[i, a]  # 0, or nan if the position is not finite
    limit = reach * reach
    for i in range(n):
        px, py, pz = x[i, 0], x[i, 1], x[i, 2] if d == 3 else 0.0
        fx, fy, fz = 0.0, 0.0, 0.0
        for j in range(i):
            dx, dy, dz = px - x[j, 0], py - x[j, 1], pz - x[j, 2] if d == 3 else 0.0
            d2 = dx * dx + dy * dy + dz * dz
            if 0.0 < d2 < limit:  # Eq. (13)
                push = stiffness * (reach / np.sqrt(d2) - 1.0)
                fx, fy, fz = fx + push * dx, fy + push * dy, fz + push * dz
                force[j, 0] -= push * dx
                force[j, 1] -= push * dy
                if d == 3:
                    force[j, 2] -= push * dz
        force[i, 0] += fx
        force[i, 1] += fy
        if d == 3:
            force[i, 2] += fz
    for i in range(n):
        spread_nan(force[i])


@compiled
def spread_nan(force):
    """Set a force that is nan along one axis to nan along all."""
    total = 0.0
    for a in range(force.shape[0]):
        total += 0.0 * force[a]
    for a in range(force.shape[0]):
        force[a] += total


@compiled
def rows(stiffness, reach, x, force):
    """Write the forces [N], visiting all others for every satellite."""
    some_rows(stiffness, reach, x, columns(x), 0, x.shape[0], force)


@on_all_cores
def rows_on_all_cores(stiffness, reach, x, force):
    """The same as `rows`, in parallel on all cores."""
    n = x.shape[0]
    places = columns(x)
    for c in prange((n + CHUNK - 1) // CHUNK):
        some_rows(stiffness, reach, x, places, c * CHUNK, min(n, (c + 1) * CHUNK), force)


@compiled
def columns(x):
    """Coordinates in rows, padded to whole lanes; positions not finite become `NOWHERE`."""
    n, d = x.shape
    out = np.full((3, (n + LANES - 1) // LANES * LANES), NOWHERE)
    for i in range(n):
        for a in range(3):
            out[a, i] = x[i, a] if a < d else 0.0
            if not np.isfinite(out[a, i]):
                out[a, i] = NOWHERE
    return out


@compiled
def some_rows(stiffness, reach, x, places, first, end, force):
    """The forces on satellites `first` to `end`."""
    sums = np.empty((3, LANES))
    for i in range(first, end):
        sums[:] = 0.0
        px, py, pz = places[0, i], places[1, i], places[2, i]
        for b in range(0, places.shape[1], LANES):
            add_lanes(
                stiffness, reach, px, py, pz,
                places[0, b : b + LANES], places[1, b : b + LANES], places[2, b : b + LANES],
                sums[0], sums[1], sums[2],
            )  # fmt: skip
        for a in range(x.shape[1]):
            total = x[i, a] - x[i, a]  # 0, or nan if the position is not finite
            for k in range(LANES):
                total += sums[a, k]
            force[i, a] = total
        spread_nan(force[i])


@compiled
def add_lanes(stiffness, reach, px, py, pz, xs, ys, zs, fx, fy, fz):
    """Add the force of each of `LANES` others on the satellite at px, py, pz; branch-free."""
    for k in range(LANES):
        dx, dy, dz = px - xs[k], py - ys[k], pz - zs[k]
        d2 = dx * dx + dy * dy + dz * dz
        push = stiffness * (reach / np.sqrt(d2) - 1.0)  # Eq. (13)
        push = push if (d2 > 0.0) & (d2 < reach * reach) else 0.0
        fx[k] += push * dx
        fy[k] += push * dy
        fz[k] += push * dz
