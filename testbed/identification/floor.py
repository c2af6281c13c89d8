"""`testbed calibrate floor`: the slope of a table as a map, from the drift of a vehicle.

The map has values on an even grid that spans the table, bilinear between (as `tilt.map` of a
table file). A smoothness prior carries it to places between the paths; where no path was, the map
is 0 and its uncertainty is that of the prior. The vehicle's numbers are fitted with it: a
controller pushes against the slope, so either alone would be wrong.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from testbed.core.vehicle import Vehicle
from testbed.identification.estimate import SCALES, follow, huber, linearise, noise_of
from testbed.identification.linearised import Pieces, normal
from testbed.identification.model import VehicleModel
from testbed.identification.motion_log import MotionLog
from testbed.identification.prediction import Valves
from testbed.identification.refused import LogRefusedError
from testbed.identification.suspicion import look_at
from testbed.identification.windows import Windows, first_guess, tiled

Array = NDArray[np.float64]
LENGTH = 4.0  # [s] of a window
FINE = 0.02  # [s] of the integrals along the path
REACH = 0.25  # correlation length, of the table's shorter side; 0.1 to 0.4 predict alike
STEEPNESS = 0.02  # [m/s^2] standard deviation of the prior
FLAT = 0.1  # of it: part that differs from node to node
TURNS = 5
OFF_TABLE = 0.01  # share of poses beside the table that a log may have
GAIN_SIGMA = 0.5  # of mass or thrust: propellers and valves give less than on a stand
DELAY_SIGMA = 0.05  # [s]


class Floor(NamedTuple):
    """Slope of the table on a grid, learned from logs."""

    size: tuple[float, float]  # [m]
    slope: Array  # (rows, columns, 2) [m/s^2]
    sigma: Array  # (rows, columns, 2) its standard deviation [m/s^2]
    reach: float  # correlation length [m]
    p: Array  # numbers of the model
    model: VehicleModel
    free: NDArray[np.int64]  # positions of those that were fitted
    covariance: Array  # of these


def check_path(logs: Sequence[MotionLog], size: Sequence[float]) -> None:
    """Check that the poses are on the table; `size` is its [m].

    Raises:
        LogRefusedError: more than some single poses are beside it.
    """
    for log in logs:
        where = log.pose[log.whole, :2]
        outside = np.abs(where) > 0.5 * np.asarray(size)
        if outside.any(axis=1).mean() > OFF_TABLE:
            far = where[np.argmax(np.max(np.abs(where), axis=1))]
            raise LogRefusedError(
                where=log.where,
                expected=f"a path on the table of {size[0]:g} m x {size[1]:g} m around its middle",
                found=f"a pose at ({far[0]:.2f}, {far[1]:.2f}) m",
                hint="see `middle` of [pose] and `table` of the mapping, or --size",
            )


def learn_floor(
    logs: Sequence[MotionLog], vehicle: Vehicle, size: tuple[float, float], nodes: int = 9
) -> Floor:
    """Learn the map from logs of one vehicle."""
    windows = [w for w in (tiled(log, LENGTH) for log in logs) if len(w.rows)]
    delay = look_at(logs, vehicle).delay
    return _fit(windows, vehicle, size, (nodes, nodes), REACH * min(size), delay)


def flat_fit(logs: Sequence[MotionLog], vehicle: Vehicle) -> tuple[VehicleModel, Array]:
    """Fit of the vehicle's numbers on a level table, for comparison."""
    windows = [w for w in (tiled(log, LENGTH) for log in logs) if len(w.rows)]
    delay = look_at(logs, vehicle).delay
    floor = _fit(windows, vehicle, (1.0, 1.0), (0, 0), 1.0, delay)
    return floor.model, floor.p


def _fit(
    windows: Sequence[Windows], vehicle: Vehicle, size: tuple[float, float],
    shape: tuple[int, int], reach: float, delay: float,
) -> Floor:  # fmt: skip
    model = VehicleModel(vehicle, valves=isinstance(windows[0].log.inputs, Valves))
    model.prior[model.index("delay")] = max(0.0, delay - vehicle.command_delay_s)
    free = model.of_groups(groups_of(model))
    p = model.prior.copy()
    nodes = shape[0] * shape[1]
    half = np.array(size) / 2.0
    ways = [_ways(w, half, shape) for w in windows]
    precision = _precision(model, free, size, shape, reach)
    heights = np.zeros((nodes, 2))
    states = [first_guess(w, np.isfinite(w.marks)) for w in windows]
    scales = SCALES
    prior = np.concatenate([model.prior[free], np.zeros(2 * nodes)])
    for turn in range(TURNS):
        model.ground = model.ground._replace(
            half=half if nodes else model.ground.half, map=heights.reshape(*shape, 2)
        )
        pieces = linearise(model, p, free, windows, states, scales, ways)
        robust = huber(pieces)
        level = float(np.average(pieces.square, weights=robust))
        now = np.concatenate([p[free], heights.T.ravel()])
        matrix, side = normal(pieces, robust / level)
        step = np.linalg.solve(matrix + precision, side + precision @ (prior - now))
        p[free] += step[: len(free)]
        p[free] = np.maximum(p[free], model.least[free])
        heights += step[len(free) :].reshape(2, nodes).T
        follow(states, pieces, step)
        if turn < TURNS - 1:
            scales = noise_of(pieces, scales)
    model.ground = model.ground._replace(map=heights.reshape(*shape, 2))
    covariance = _covariance(pieces, robust / level, matrix, precision)
    spread = np.sqrt(np.diag(covariance))[len(free) :].reshape(2, nodes).T
    own = covariance[: len(free), : len(free)]
    found = heights.reshape(*shape, 2), spread.reshape(*shape, 2)
    return Floor(size, *found, reach, p, model, free, own)


def groups_of(model: VehicleModel) -> list[str]:
    """The groups of numbers that are fitted with the map; the map takes the place of the slope.

    Jets that differ from the file push like a slope where the vehicle keeps its heading.
    """
    if not model.valves:
        return ["thrust", "delay"]
    return [g for g in model.groups if g not in ("slope", "hold")]


def _covariance(pieces: Pieces, weights: Array, matrix: Array, precision: Array) -> Array:
    """Covariance that holds also where errors within a window go together.

    Each window is one observation; never less than independent errors would give.
    """
    inverse = np.linalg.inv(matrix + precision)
    pulls = weights[:, None] * pieces.side
    clustered = inverse @ (pulls.T @ pulls + precision) @ inverse
    grow = np.sqrt(np.maximum(1.0, np.diag(clustered) / np.diag(inverse)))
    return np.asarray(inverse * np.outer(grow, grow))


def _precision(
    model: VehicleModel, free: NDArray[np.int64], size: tuple[float, float], shape: tuple[int, int],
    reach: float,
) -> Array:  # fmt: skip
    """Inverse covariance of the prior: the vehicle's numbers, then the map of x and of y."""
    sigma = model.sigma[free].copy()
    sigma[free == 0], sigma[free == model.index("delay")] = GAIN_SIGMA, DELAY_SIGMA
    nodes = shape[0] * shape[1]
    precision = np.zeros((len(free) + 2 * nodes,) * 2)
    precision[: len(free), : len(free)] = np.diag(1.0 / sigma**2)
    if nodes:
        y, x = np.meshgrid(*(np.linspace(-0.5, 0.5, n) for n in shape), indexing="ij")
        place = np.stack([x.ravel() * size[0], y.ravel() * size[1]], axis=1)
        gap = np.sum((place[:, None] - place[None]) ** 2, axis=2)
        cover = STEEPNESS**2 * (np.exp(-0.5 * gap / reach**2) + FLAT**2 * np.eye(nodes))
        inverse = np.linalg.inv(cover)
        for axis in (0, 1):
            a = len(free) + axis * nodes
            precision[a : a + nodes, a : a + nodes] = inverse
    return precision


def _ways(windows: Windows, half: Array, shape: tuple[int, int]) -> Array:
    """Displacement at each pose by a unit slope at each node, (w, m, nodes)."""
    rows, columns = shape
    found = np.zeros((*windows.marks.shape, rows * columns))
    for k, own in enumerate(windows.rows):
        t = windows.log.t[own]
        fine = np.arange(t[0], t[-1] + FINE, FINE)
        path = [np.interp(fine, t, windows.log.pose[own, axis]) for axis in (0, 1)]
        weights = np.zeros((len(fine), rows * columns))
        if rows:
            u = np.clip((path[0] / half[0] + 1.0) * 0.5, 0.0, 1.0) * (columns - 1)
            v = np.clip((path[1] / half[1] + 1.0) * 0.5, 0.0, 1.0) * (rows - 1)
            i, j = np.minimum(u.astype(int), columns - 2), np.minimum(v.astype(int), rows - 2)
            a, b = u - i, v - j
            at = np.arange(len(fine))
            for dj, di, w in ((0, 0, (1 - a) * (1 - b)), (0, 1, a * (1 - b)),
                              (1, 0, (1 - a) * b), (1, 1, a * b)):  # fmt: skip
                weights[at, (j + dj) * columns + i + di] += w
        speed = np.cumsum(weights, axis=0) * FINE
        way = np.cumsum(speed, axis=0) * FINE - 0.5 * FINE * speed
        at = np.minimum((t - t[0]) / FINE, len(fine) - 1.001)
        before, part = at.astype(int), (at % 1.0)[:, None]
        found[k, : len(own)] = (1.0 - part) * way[before] + part * way[before + 1]
    return found
