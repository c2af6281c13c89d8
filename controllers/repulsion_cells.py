"""The repulsion of `controllers/repulsion.py` over a grid of cells: O(n) while s holds few.

A satellite interacts only with satellites in its own cell and the adjacent ones. Satellites are
sorted by cell, and cells consecutive along x are contiguous in memory: nine short blocks of memory
hold all partners in space, three in a plane. Empty cells cost nothing.
"""

from collections.abc import Callable

import numba
import numpy as np
from numba import prange

from testbed.core.compiled import compiled, inlined

CHUNK = 256  # satellites that a thread takes at a time
HELD = 256  # initial capacity for positions around a cell
WIDER = 1.0 + 1e-9  # cell width over s: above 1, so that rounding puts no partner two cells away
FAR = 2.0**51  # [cells] beyond it a float cannot resolve a cell


def on_all_cores(function: Callable) -> Callable:
    """Compile with threads; like `compiled`, without fast-math."""
    return numba.njit(cache=True, error_model="numpy", parallel=True)(function)


@compiled
def cells(stiffness, reach, x, force):
    """Write the forces [N], visiting the adjacent cells of every satellite."""
    n = x.shape[0]
    grid, start, who = sorted_into_cells(x, reach)
    row, places = np.empty(n, dtype=np.int64), np.zeros((3, n))
    some_places(reach, x, who, 0, n, row, places)
    some_cells(stiffness, reach, grid, start, who, row, places, 0, n, force)


@on_all_cores
def cells_on_all_cores(stiffness, reach, x, force):
    """The same as `cells`, in parallel on all cores."""
    n = x.shape[0]
    grid, start, who = sorted_into_cells(x, reach)
    row, places = np.empty(n, dtype=np.int64), np.zeros((3, n))
    for c in prange((n + CHUNK - 1) // CHUNK):
        some_places(reach, x, who, c * CHUNK, min(n, (c + 1) * CHUNK), row, places)
    for c in prange((n + CHUNK - 1) // CHUNK):
        end = min(n, (c + 1) * CHUNK)
        some_cells(stiffness, reach, grid, start, who, row, places, c * CHUNK, end, force)


@compiled
def cell_width(reach):
    """Width of a cell, at least the reach of the force [m]."""
    return reach * WIDER if reach > 0.0 else 1.0


@compiled
def cell_of(coordinate, width):
    """Index of the cell along one axis; 0 if it cannot be resolved."""
    number = np.floor(coordinate / width)
    return np.int64(number) if abs(number) < FAR else np.int64(0)


@compiled
def row_of(cy, cz):
    """Key of a row of cells along x; unique for rows less than 2^31 cells apart."""
    return (cy & 0x7FFFFFFF) | ((cz & 0x7FFFFFFF) << 32)


@compiled
def grid_of(x, width):
    """Memory layout of the rows of cells: number of buckets, strides along y and z, shift.

    The layout follows space if the bounding box has not many more cells than there are satellites:
    then neighbours are close in memory. Otherwise the rows are hashed.
    """
    n, d = x.shape
    size = 4
    while size < 2 * n:
        size *= 2
    across = extent_of(x, 0) / width + 3.0
    layer = across * (extent_of(x, 1) / width + 3.0)
    volume = layer * (extent_of(x, 2) / width + 3.0) if d == 3 else layer
    if 0.0 < volume <= size:
        return size, np.int64(across), np.int64(layer), np.uint64(0)
    return size, np.int64(0x1E3779B97F4A7C15), np.int64(0x3F58476D1CE4E5B9), np.uint64(33)


@compiled
def bucket_of(grid, cx, cy, cz):
    """Bucket of a cell; cells of a row are consecutive."""
    size, along_y, along_z, shift = grid
    return (np.int64(np.uint64(cy * along_y + cz * along_z) >> shift) + cx) & (size - 1)


@compiled
def sorted_into_cells(x, reach):
    """Stable counting sort of the satellites by bucket.

    Returns:
        the grid; start of each bucket, shape (buckets + 1,); satellite indices in bucket order.
    """
    n, d = x.shape
    width = cell_width(reach)
    grid = grid_of(x, width)
    start, bucket = np.zeros(grid[0] + 1, dtype=np.int32), np.empty(n, dtype=np.int32)
    for i in range(n):
        cx, cy = cell_of(x[i, 0], width), cell_of(x[i, 1], width)
        bucket[i] = bucket_of(grid, cx, cy, cell_of(x[i, 2], width) if d == 3 else np.int64(0))
        start[bucket[i] + 1] += 1
    for b in range(grid[0]):
        start[b + 1] += start[b]
    free, who = start[:-1].copy(), np.empty(n, dtype=np.int32)
    for i in range(n):
        who[free[bucket[i]]] = i
        free[bucket[i]] += 1
    return grid, start, who


@compiled
def some_places(reach, x, who, first, end, row, places):
    """Write row keys and positions [m] of `first` to `end` in the order of the buckets."""
    width = cell_width(reach)
    for k in range(first, end):
        for a in range(x.shape[1]):
            places[a, k] = x[who[k], a]
        row[k] = row_of(cell_of(places[1, k], width), cell_of(places[2, k], width))


@compiled
def some_cells(stiffness, reach, grid, start, who, row, places, first, end, force):
    """The forces on satellites `first` to `end` in the order of the buckets.

    Satellites of one cell are consecutive. Their partners are looked up once per cell: all
    satellites near the bounding box of the cell's satellites, which is smaller than the cell.
    Rounding is monotonic, so no partner is nearer to a satellite than to the box.
    """
    d, width, limit = force.shape[1], cell_width(reach), reach * reach
    xs, ys, zs = places[0], places[1], places[2]
    around, pushes = np.empty((4, HELD)), np.empty((3, HELD))
    box, pieces = np.empty((3, 2)), np.empty((27, 3), dtype=np.int64)
    k = first
    while k < end:
        cx, cy, cz = cell_of(xs[k], width), cell_of(ys[k], width), cell_of(zs[k], width)
        box[:, 0], box[:, 1] = np.inf, -np.inf
        last = k
        while last < end and row[last] == row[k] and cell_of(xs[last], width) == cx:
            for a in range(3):
                place = places[a, last]
                if abs(place) < np.inf:
                    box[a, 0], box[a, 1] = min(box[a, 0], place), max(box[a, 1], place)
            last += 1
        used, most = look_up(grid, start, cx, cy, cz, d, pieces)
        if most > around.shape[1]:
            around, pushes = np.empty((4, 2 * most)), np.empty((3, 2 * most))
        count = gather(grid[3] > 0, pieces, used, row, places, around)
        count = keep_near(box, limit, around, count)
        for i in range(k, last):
            fx, fy, fz = push_on(stiffness, reach, xs[i], ys[i], zs[i], around, count, pushes)
            nowhere = 0.0 * (fx + fy + fz)
            force[who[i], 0], force[who[i], 1] = fx + nowhere, fy + nowhere
            if d == 3:
                force[who[i], 2] = fz + nowhere
        k = last


@compiled
def look_up(grid, start, cx, cy, cz, d, pieces):
    """Blocks of memory of a cell and its neighbours: row, from, to; number of blocks, positions."""
    mask, deep = grid[0] - 1, 1 if d == 3 else 0
    used, most = 0, 0
    for up in range(-deep, deep + 1):
        for side in range(-1, 2):
            low = bucket_of(grid, cx - 1, cy + side, cz + up)
            together = low + 2 <= mask  # three buckets are one block unless they wrap round
            for part in range(1 if together else 3):
                b = (low + part) & mask
                pieces[used, 0] = row_of(cy + side, cz + up)
                pieces[used, 1], pieces[used, 2] = start[b], start[b + 3 if together else b + 1]
                most += pieces[used, 2] - pieces[used, 1]
                used += 1
    return used, most


@compiled
def gather(scattered, pieces, used, row, places, around):
    """Copy the positions of all blocks to `around`; returns how many."""
    xs, ys, zs = places[0], places[1], places[2]
    ax, ay, az = around[0], around[1], around[2]
    n = np.uint64(0)  # unsigned: saves the check for a negative index
    for p in range(used):
        name, first, count = pieces[p, 0], pieces[p, 1], pieces[p, 2] - pieces[p, 1]
        if scattered:  # then a bucket can hold other rows, too
            for m in range(count):
                j = np.uint64(first + m)
                ax[n], ay[n], az[n] = xs[j], ys[j], zs[j]
                n += np.uint64(row[j] == name)
        else:
            for m in range(count):
                j, q = np.uint64(first + m), n + np.uint64(m)
                ax[q], ay[q], az[q] = xs[j], ys[j], zs[j]
            n += np.uint64(count)
    return np.int64(n)


@compiled
def keep_near(box, limit, around, count):
    """Move positions nearer to the box than s to the front of `around`; returns how many."""
    xs, ys, zs, square = around[0], around[1], around[2], around[3]
    x0, x1, y0, y1, z0, z1 = box[0, 0], box[0, 1], box[1, 0], box[1, 1], box[2, 0], box[2, 1]
    for m in range(count):
        dx, dy, dz = outside(xs[m], x0, x1), outside(ys[m], y0, y1), outside(zs[m], z0, z1)
        square[m] = dx * dx + dy * dy + dz * dz
    n = np.uint64(0)
    for m in range(count):  # branch-free: a branch would be mispredicted too often
        j = np.uint64(m)
        xs[n], ys[n], zs[n] = xs[j], ys[j], zs[j]
        n += np.uint64(square[j] < limit)
    return np.int64(n)


@compiled
def outside(place, low, high):
    """Distance of a coordinate from the interval `low` to `high` [m]."""
    out = low - place if low - place > place - high else place - high
    return 0.0 if out < 0.0 else out  # nan stays nan


@inlined
def push_on(stiffness, reach, x, y, z, around, count, pushes):
    """Force of the positions `around` on the satellite at x, y, z [N]; branch-free first loop."""
    xs, ys, zs = around[0], around[1], around[2]
    px, py, pz = pushes[0], pushes[1], pushes[2]
    for m in range(count):
        dx, dy, dz = x - xs[m], y - ys[m], z - zs[m]
        d2 = dx * dx + dy * dy + dz * dz
        push = stiffness * (reach / np.sqrt(d2) - 1.0)  # Eq. (13)
        push = push if (d2 > 0.0) & (d2 < reach * reach) else 0.0
        px[m], py[m], pz[m] = push * dx, push * dy, push * dz
    fx, fy, fz = x - x, y - y, z - z  # 0, or nan if the position is not finite
    for m in range(count):
        fx, fy, fz = fx + px[m], fy + py[m], fz + pz[m]
    return fx, fy, fz


@compiled
def extent_of(x, a):
    """Extent of the finite positions along an axis [m]; -inf without any."""
    low, high = np.inf, -np.inf
    for i in range(x.shape[0]):
        place = x[i, a]
        if abs(place) < np.inf:
            low, high = min(low, place), max(high, place)
    return high - low
