r"""Short-range repulsion between many satellites, in 2-D and 3-D, without an N x N array.

Source: Eq. (12), (13) of W. Gao, K. Li, C. Wei, "Satellite Cluster Formation Reconfiguration Based
on the Bifurcating Potential Field", Aerospace 9:137, 2022.

    U_ij = (k_c / 2) (s - d)^2                 for d < s, else 0                    Eq. (12)
    F_ij = k_c (s / d - 1) (x_i - x_j)         for d < s, else 0                    Eq. (13)

    paper        code         meaning                                        unit
    x_i          x            positions, shape (n, 2) or (n, 3)              m
    d            d            distance of i and j                            m
    s            reach        where repulsion ends                           m
    k_c          stiffness                                                   N/m

Differences from the paper: its Eq. (13) has the opposite sign, which attracts at every d < s, and
its Eq. (12) is not a primitive of it; above is what its figures need. Where two satellites are at
the same place (d = 0) no direction is any better than another, and the force between them is zero.
A satellite that is not at a finite place gets nan for its force and pushes nobody.

Three ways to the same sum, which differ in rounding only:

    `pairs`   every pair once: the fastest for some hundreds
    `rows`    every satellite asks all others: for many who all see each other
    `cells`   every satellite asks those in its own and the neighbouring cells of a grid of width s.
              Cells are hashed, so that empty space costs nothing; those that follow each other
              along x are neighbours in memory. O(n) while s holds few satellites.

The last two have a version for all cores. There, too, each satellite sums up its own neighbours in
the order in which they are stored, so the result is the same, bit for bit, with any number of
threads and without them.
"""

from collections.abc import Callable

import numba
import numpy as np
from numba import prange
from numpy.typing import ArrayLike, NDArray

from testbed.core.compiled import compiled  # says where numba keeps machine code, too

Array = NDArray[np.float64]

FEW = 256  # satellites up to which `pairs` is the fastest
MANY_ROWS, MANY_CELLS = 2048, 16384  # satellites from which threads pay
CHUNK = 256  # satellites that a thread takes at a time
HELD = 256  # places round a cell that there is room for at first
LANES = 64  # partial sums, so that the sum over all can be vectorised in a fixed order
CROWDED = 0.3  # share of all pairs in neighbouring cells above which `rows` beats `cells`
WIDER = 1.0 + 1e-9  # cells are a hair wider than s, so that rounding puts no partner two cells off
NOWHERE = 1e300  # [m] too far from anything to be pushed, yet finite
FAR = 2.0**51  # [cells] beyond it a float does not know its cell


def _parallel(function: Callable) -> Callable:
    return numba.njit(cache=True, error_model="numpy", parallel=True)(function)


def repulsion(x: ArrayLike, stiffness: float, reach: float) -> Array:
    """Force on each satellite, shape (n, d) [N], by the fastest of the three ways.

    Args:
        x: positions, shape (n, 2) or (n, 3) [m].
        stiffness: k_c [N/m].
        reach: s [m].

    Raises:
        ValueError: shapes or parameters that make no sense.
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
    """Share of all pairs that an even spread over the bounding box puts in neighbouring cells."""
    share = 1.0
    for a in range(x.shape[1]):
        low, high = np.inf, -np.inf
        for i in range(x.shape[0]):
            if np.isfinite(x[i, a]):
                low, high = min(low, x[i, a]), max(high, x[i, a])
        if high - low > 3.0 * reach:
            share *= 3.0 * reach / (high - low)
    return share


@compiled
def pairs(stiffness, reach, x, force):
    """Write the forces [N]; every pair once. For compiled laws, too: it keeps no memory."""
    n, d = x.shape
    for i in range(n):
        for a in range(d):
            force[i, a] = x[i, a] - x[i, a]  # 0, or nan at no finite place
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
        spread_nan(force, i)


@compiled
def spread_nan(force, i):
    """A force that is nan along one axis is nan along all."""
    total = 0.0
    for a in range(force.shape[1]):
        total += 0.0 * force[i, a]
    for a in range(force.shape[1]):
        force[i, a] += total


@compiled
def rows(stiffness, reach, x, force):
    """Write the forces [N]; every satellite asks all others."""
    some_rows(stiffness, reach, x, columns(x), 0, x.shape[0], force)


@_parallel
def rows_on_all_cores(stiffness, reach, x, force):
    """The same on all cores."""
    n = x.shape[0]
    places = columns(x)
    for c in prange((n + CHUNK - 1) // CHUNK):
        some_rows(stiffness, reach, x, places, c * CHUNK, min(n, (c + 1) * CHUNK), force)


@compiled
def columns(x):
    """Coordinates in rows, filled up to whole lanes; who is at no finite place is far away."""
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
            total = x[i, a] - x[i, a]  # 0, or nan at no finite place
            for k in range(LANES):
                total += sums[a, k]
            force[i, a] = total
        spread_nan(force, i)


@compiled
def add_lanes(stiffness, reach, px, py, pz, xs, ys, zs, fx, fy, fz):
    """Add what each of `LANES` others does to the one at px, py, pz; without branches."""
    for k in range(LANES):
        dx, dy, dz = px - xs[k], py - ys[k], pz - zs[k]
        d2 = dx * dx + dy * dy + dz * dz
        push = stiffness * (reach / np.sqrt(d2) - 1.0)  # Eq. (13)
        push = push if (d2 > 0.0) & (d2 < reach * reach) else 0.0
        fx[k] += push * dx
        fy[k] += push * dy
        fz[k] += push * dz


@compiled
def cells(stiffness, reach, x, force):
    """Write the forces [N]; every satellite asks those in the cells around it."""
    start, who, row, places = sorted_into_cells(x, reach)
    some_cells(stiffness, reach, start, who, row, places, 0, x.shape[0], force)


@_parallel
def cells_on_all_cores(stiffness, reach, x, force):
    """The same on all cores."""
    n = x.shape[0]
    start, who, row, places = sorted_into_cells(x, reach)
    for c in prange((n + CHUNK - 1) // CHUNK):
        end = min(n, (c + 1) * CHUNK)
        some_cells(stiffness, reach, start, who, row, places, c * CHUNK, end, force)


@compiled
def cell_width(reach):
    """[m]."""
    return reach * WIDER if reach > 0.0 else 1.0


@compiled
def cell_of(coordinate, width):
    """Number of the cell along one axis; 0 where there is no telling."""
    number = np.floor(coordinate / width)
    return np.int64(number) if abs(number) < FAR else np.int64(0)


@compiled
def row_of(cy, cz):
    """Name of a row of cells along x: unique unless 2^31 cells apart."""
    return (cy & 0x7FFFFFFF) | ((cz & 0x7FFFFFFF) << 32)


@compiled
def bucket_of(row, cx, mask):
    """Where a cell is kept: rows are scattered, within a row cells follow each other."""
    mixed = np.uint64(row) * np.uint64(0x9E3779B97F4A7C15)
    return (np.int64(mixed >> np.uint64(33)) + cx) & mask


@compiled
def sorted_into_cells(x, reach):
    """Counting sort of the satellites by bucket; equals keep their order.

    Returns:
        where each bucket starts, shape (buckets + 1,); and in the order of the buckets the
        satellites' index, the name of their row of cells, and their place, shape (3, n) [m].
    """
    n, d = x.shape
    width = cell_width(reach)
    size = 4
    while size < 2 * n:
        size *= 2
    start = np.zeros(size + 1, dtype=np.int32)
    bucket, name = np.empty(n, dtype=np.int32), np.empty(n, dtype=np.int64)
    for i in range(n):
        cz = cell_of(x[i, 2], width) if d == 3 else np.int64(0)
        name[i] = row_of(cell_of(x[i, 1], width), cz)
        bucket[i] = bucket_of(name[i], cell_of(x[i, 0], width), size - 1)
        start[bucket[i] + 1] += 1
    for b in range(size):
        start[b + 1] += start[b]
    free = start[:size].copy()
    who, row, places = np.empty(n, np.int32), np.empty(n, np.int64), np.zeros((3, n))
    for i in range(n):
        k = free[bucket[i]]
        free[bucket[i]] += 1
        who[k], row[k] = i, name[i]
        for a in range(d):
            places[a, k] = x[i, a]
    return start, who, row, places


@compiled
def some_cells(stiffness, reach, start, who, row, places, first, end, force):
    """The forces on satellites `first` to `end` in the order of the buckets.

    Those of one cell follow each other, and whoever is around it is looked up once for all of them.
    """
    d, width = force.shape[1], cell_width(reach)
    xs, ys, zs = places[0], places[1], places[2]
    limit, room, count = reach * reach, HELD, 0
    around, square, near = np.empty((3, room)), np.empty(room), np.empty(room, dtype=np.int64)
    ox, oy, oz = np.int64(0), np.int64(0), np.int64(0)  # the cell that `around` belongs to
    for k in range(first, end):
        x, y, z = xs[k], ys[k], zs[k]
        cx, cy, cz = cell_of(x, width), cell_of(y, width), cell_of(z, width)
        if k == first or cx != ox or cy != oy or cz != oz:
            ox, oy, oz = cx, cy, cz
            most = how_many_around(start, cx, cy, cz, d)
            if most > room:
                room = 2 * most
                around, square = np.empty((3, room)), np.empty(room)
                near = np.empty(room, dtype=np.int64)
            count = gather(start, row, xs, ys, zs, cx, cy, cz, d, around)
        ax, ay, az = around[0], around[1], around[2]
        for m in range(count):
            dx, dy, dz = x - ax[m], y - ay[m], z - az[m]
            square[m] = dx * dx + dy * dy + dz * dz
        n = np.uint64(0)  # unsigned: such an index needs no look at its sign
        for m in range(count):  # no branch, because it would be guessed wrong too often
            near[n] = m
            n += np.uint64((square[m] > 0.0) & (square[m] < limit))
        fx, fy, fz = x - x, y - y, z - z  # 0, or nan at no finite place
        for q in range(n):
            m = np.uint64(near[q])
            push = stiffness * (reach / np.sqrt(square[m]) - 1.0)  # Eq. (13)
            fx += push * (x - ax[m])
            fy += push * (y - ay[m])
            fz += push * (z - az[m])
        force[who[k], 0], force[who[k], 1] = fx, fy
        if d == 3:
            force[who[k], 2] = fz
        spread_nan(force, who[k])


@compiled
def how_many_around(start, cx, cy, cz, d):
    """At most; others in the same buckets included."""
    mask, total = start.shape[0] - 2, 0
    deep = 1 if d == 3 else 0
    for up in range(-deep, deep + 1):
        for side in range(-1, 2):
            low = bucket_of(row_of(cy + side, cz + up), cx - 1, mask)
            for part in range(3):
                b = (low + part) & mask
                total += start[b + 1] - start[b]
    return total


@compiled
def gather(start, row, xs, ys, zs, cx, cy, cz, d, around):
    """Write the places in a cell and those around it into `around`; returns how many."""
    mask, n = start.shape[0] - 2, np.uint64(0)
    deep = 1 if d == 3 else 0
    for up in range(-deep, deep + 1):
        for side in range(-1, 2):
            name = row_of(cy + side, cz + up)
            low = bucket_of(name, cx - 1, mask)
            together = low + 2 <= mask  # three buckets in one piece, unless round the end
            for part in range(1 if together else 3):
                b = (low + part) & mask
                for m in range(start[b], start[b + 3 if together else b + 1]):
                    j = np.uint64(m)
                    if row[j] == name:  # else another row in the same bucket
                        around[0, n], around[1, n], around[2, n] = xs[j], ys[j], zs[j]
                        n += np.uint64(1)
    return np.int64(n)
