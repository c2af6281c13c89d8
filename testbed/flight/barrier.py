r"""Safety filter: the smallest change of a demanded force that leaves room to stop.

The filter works with any law. With mass m, jet period T, bias b (the acceleration not caused by
jets) and the unit vector n from a hazard to the vehicle, `gap` d and closing speed c = -n v,
the speed after the coming period must allow a stop within the gap that is left then:

    c1^2 / (2 a s) + (c0 + c1) T'/2 + e <= d,     a force f gives   c1 = c0 - T n (f/m + b)

This is a discrete-time barrier for the braking distance. It bounds c1 and so is a half-plane for f;
the disc |f| <= F is the force that the jets can give in any direction. The nearest f is found
exactly: it is the demand itself, its projection on one half-plane, a corner of two, or a point on
the disc's rim; all candidates are tried. If the intersection is empty, all half-planes are widened
by the same least amount.

    a     planned deceleration of a stop: a share of F / m, which leaves a margin for two hazards at
          right angles and for the error of the jets, and at most LEFT of F / m + n b: the part
          that a slope towards the hazard takes is not there for a stop
    s     responsibility. 1 for edges and obstacles. Two vehicles take half of their gap each and
          count their own speed only: as long as each keeps c_i^2 / (2 a) <= d / 2, both can stop at
          the same time, without knowing the other's plan
    T'    T plus the reaction time of unmodelled parts
    e     how far a neighbour approaches in a period T

At an effort of 1/2 two vehicles that keep to this close in by at most sqrt(d / 2) (sqrt(h1) +
sqrt(h2)), h being the deceleration by all jets of each. The room left by a full stop takes that
speed and the deceleration ((sqrt(h1) + sqrt(h2)) / 2)^2: it is h if they are equal, and the room is
0 at the limit of the filter.

A second bound keeps a stop straight against the velocity within the gap, v c1 / (2 F/m) <= s d: it
does not trade one hazard for another, and does not turn when the normal does.

An obstacle moves at constant speed and does not avoid vehicles: its closing speed is the relative
one, and `escape` makes sure that a way out of its path remains. A tangent of a disc is on its safe
side, and the normal is taken at the positions of vehicle and hazard half a period later.

See A. D. Ames et al., "Control barrier functions: theory and applications", European Control
Conference, 2019, and L. Wang, A. D. Ames, M. Egerstedt, "Safety barrier certificates for
collisions-free multirobot systems", IEEE Transactions on Robotics 33(3), 2017, for barriers made of
braking distances; the split of the gap is ours.
"""

from collections.abc import Iterable, Mapping, Sequence
from typing import Annotated, NamedTuple

import numpy as np
from msgspec import Meta, Struct
from numpy.typing import NDArray

from testbed.core.codes import Hazard, Intervention
from testbed.core.compiled import compiled, with_fixed_types
from testbed.core.rows import States
from testbed.core.scratch import scratch
from testbed.core.table import Obstacle
from testbed.core.types import State
from testbed.core.vehicle import LOWEST_SHARE, NonNegative, Positive
from testbed.flight.escape import CLEAR, URGENT, escape, reached_in
from testbed.flight.half_planes import TIGHT, yielding

Array = NDArray[np.float64]

RETREAT = 0.02  # largest speed out of a forbidden place [m/s]
RETREAT_RATE = 0.5  # speed of a retreat per depth [1/s]
FASTER = 0.1  # margin of speed in the selection of near neighbours [m/s]
KEPT = 1.0  # longest extrapolation of a silent neighbour's position; its speed still counts [s]
EDGES = tuple(Hazard)[Hazard.RIGHT_EDGE - 1 :]  # in the order of `filtered`
BEYOND = 1e3  # out of reach of every vehicle [m]
WIDTH = 7  # numbers of a disc, and of another vehicle
LEFT = 2.0 / 3.0  # planned share of the deceleration that a bias leaves: jets may be weak, too
LEAST = 0.1  # of the planned deceleration, however large the bias


class BarrierParams(Struct, frozen=True, forbid_unknown_fields=True):
    """Margins to hazards, and braking effort."""

    on: bool = True
    effort: Annotated[float, Meta(gt=0.0, le=1.0)] = 0.5  # of the jets' weakest direction
    reaction_s: NonNegative = 0.2
    vehicle_margin: NonNegative = 0.06  # between the rims of two vehicles [m]
    obstacle_margin: NonNegative = 0.005  # beyond the danger radius [m]
    # between a rim and the fence [m]: a stopped vehicle slides on an unlevel table, 5 cm in 7 s
    edge_margin: NonNegative = 0.05
    max_speed: Positive = 0.25  # [m/s]


class Limits(NamedTuple):
    """Constants of the filter for compiled code."""

    mass: float  # [kg]
    force: float  # in any direction [N]
    decel: float  # planned for a stop [m/s^2]
    hard: float  # largest deceleration by the jets [m/s^2]
    period: float  # [s]
    slow: float  # T' [s]
    speed: float  # [m/s]
    half_x: float  # where the centre may be [m]
    half_y: float  # [m]


UNLIMITED = Limits(*[np.inf] * len(Limits._fields))  # without a filter


@compiled
def speed_left(gap, closing, speed, decel, hard, slow):
    """Largest closing speed after a period that began with `closing` and `gap` [m/s]."""
    room = gap - 0.5 * slow * max(closing, 0.0)
    if room < 0.0:
        return max(-RETREAT, RETREAT_RATE * room)
    left = decel * (np.sqrt(0.25 * slow * slow + 2.0 * room / decel) - 0.5 * slow)
    return min(left, 2.0 * hard * room / speed) if speed * left > 2.0 * hard * room else left


@compiled
def bound(planes, count, nx, ny, gap, closing, speed, hazard, limits, shares, bx, by):
    """Add a hazard's half-plane if it could matter; returns the rows in use.

    `shares` of the planned deceleration are `thrust_scale` and responsibility, see `filtered`.
    """
    share, away = shares[0] * shares[1], shares[1] * (nx * bx + ny * by)
    decel, hard = share * limits.decel, share * limits.hard
    if away < 0.0:
        decel = max(LEAST * decel, min(decel, LEFT * (hard + away)))
    left = speed_left(gap, closing, speed, decel, hard, limits.slow)
    # -n f <= m ((c1 - c0) / T + n b)
    h = limits.mass * ((left - closing) / limits.period + nx * bx + ny * by)
    if h < 3.0 * limits.force:
        planes[count, 0], planes[count, 1], planes[count, 2] = -nx, -ny, h
        planes[count, 3] = hazard
        count += 1
    return count


@compiled
def filtered(fx, fy, px, py, vx, vy, bx, by, discs, limits, thrust_scale):
    """The force nearest to the demand that leaves room to stop.

    Args:
        fx: demanded mean force over the coming period in W [N].
        fy: [N].
        px: position at its start [m].
        py: [m].
        vx: velocity [m/s].
        vy: [m/s].
        bx: bias [m/s^2].
        by: [m/s^2].
        discs: rows (x, y, vx, vy, distance of the centres to keep, responsibility, largest
            deceleration [m/s^2]); a responsibility below 1 is another vehicle's, as is the last.
        limits: constants.
        thrust_scale: the jets' force at the present supply pressure, and without those taken out,
            as a share of the usual one.

    Returns:
        fx, fy, deciding hazard or -1 (number of the disc; then right, left, upper, lower edge; then
        the speed limit), spare room [m]: the smallest gap minus the distance of a full stop. An
        obstacle that moves does not count: it reaches a vehicle that stops, see escape.py.
    """
    n = discs.shape[0]
    planes = scratch((n + 5, 4))
    count, spare = 0, np.inf
    ahead, hard = 0.5 * limits.period, thrust_scale * limits.hard
    speed = np.sqrt(vx * vx + vy * vy)
    for k in range(n):
        rx, ry = px - discs[k, 0], py - discs[k, 1]
        ux, uy = vx - discs[k, 2], vy - discs[k, 3]
        mx, my = rx + ahead * ux, ry + ahead * uy
        middle = np.sqrt(mx * mx + my * my)
        nx, ny = (mx / middle, my / middle) if middle > 1e-6 else (1.0, 0.0)
        gap = np.sqrt(rx * rx + ry * ry) - discs[k, 4]
        relative = -(nx * ux + ny * uy)
        moves = discs[k, 5] == 1.0 and (discs[k, 2] != 0.0 or discs[k, 3] != 0.0)
        if relative > 0.0 and not moves:
            stop = hard
            if discs[k, 5] < 1.0:
                stop = 0.25 * (np.sqrt(hard) + np.sqrt(discs[k, 6])) ** 2
            spare = min(spare, gap - relative * relative / (2.0 * stop))
        if discs[k, 5] < 1.0:
            closing, moving = -(nx * vx + ny * vy), speed
            gap -= limits.period * max(0.0, nx * discs[k, 2] + ny * discs[k, 3])
        else:
            closing, moving = relative, np.sqrt(ux * ux + uy * uy)
        shares = thrust_scale, discs[k, 5]
        count = bound(planes, count, nx, ny, gap, closing, moving, k, limits, shares, bx, by)
    for edge in range(4):
        side = 1.0 - 2.0 * (edge % 2)
        if edge < 2:
            gap, closing, nx, ny = limits.half_x - side * px, side * vx, -side, 0.0
        else:
            gap, closing, nx, ny = limits.half_y - side * py, side * vy, 0.0, -side
        if closing > 0.0:
            spare = min(spare, gap - closing * closing / (2.0 * hard))
        shares = thrust_scale, 1.0
        count = bound(planes, count, nx, ny, gap, closing, speed, n + edge, limits, shares, bx, by)
    if speed > 0.5 * limits.speed:
        gx, gy = vx / speed, vy / speed
        planes[count, 0], planes[count, 1] = gx, gy
        planes[count, 2] = limits.mass * (
            (limits.speed - speed) / limits.period - gx * bx - gy * by
        )
        planes[count, 3] = n + 4
        count += 1
    worst, hazard = TIGHT, -1
    for i in range(count):
        off = planes[i, 0] * fx + planes[i, 1] * fy - planes[i, 2]
        if off > worst:
            worst, hazard = off, int(planes[i, 3])
    if hazard < 0:
        return fx, fy, hazard, spare
    x, y = yielding(fx, fy, planes, count, limits.force * thrust_scale)
    return x, y, hazard, spare


@compiled
def around(t, px, py, speed, obstacles, others, limits, thrust_scale):
    """Relevant hazards at time `t`: all obstacles, and neighbours within reach.

    Args:
        t: [s].
        px: own position [m].
        py: [m].
        speed: own [m/s].
        obstacles: at time 0, rows as in `filtered`.
        others: rows (x, y, vx, vy, distance of the centres to keep, time of the row, largest
            deceleration [m/s^2]).
        limits: constants.
        thrust_scale: see `filtered`.

    Returns:
        discs as in `filtered`, and the row of each in obstacles and others together.
    """
    discs = np.empty((obstacles.shape[0] + others.shape[0], WIDTH))
    rows = np.empty(discs.shape[0], dtype=np.int64)
    count, decel = obstacles.shape[0], thrust_scale * limits.decel
    for k in range(count):
        discs[k], rows[k] = obstacles[k], k
        discs[k, 0] += t * obstacles[k, 2]
        discs[k, 1] += t * obstacles[k, 3]
    for k in range(others.shape[0]):
        vx, vy, age = others[k, 2], others[k, 3], t - others[k, 5]
        on = min(max(age, 0.0), KEPT)
        # its possible motion since then, beyond the margin
        late = min(max(age - 2.0 * limits.slow, 0.0), KEPT)
        keep = others[k, 4] + 0.5 * limits.decel * late * late
        x, y = others[k, 0] + on * vx, others[k, 1] + on * vy
        fast = speed + np.hypot(vx, vy) + FASTER
        if np.hypot(px - x, py - y) > keep + fast * (fast / decel + limits.slow):
            continue
        discs[count, 0], discs[count, 1], discs[count, 2], discs[count, 3] = x, y, vx, vy
        discs[count, 4], discs[count, 5], discs[count, 6] = keep, 0.5, others[k, 6]
        rows[count] = obstacles.shape[0] + k
        count += 1
    return discs[:count], rows[:count]


@compiled
def standing(discs):
    """`discs` with moving obstacles out of reach: a flight that is clear may pass them."""
    still = discs.copy()
    for k in range(discs.shape[0]):
        if discs[k, 5] == 1.0 and (discs[k, 2] != 0.0 or discs[k, 3] != 0.0):
            still[k, 0] += BEYOND
    return still


@compiled
def guarded(t, fx, fy, px, py, vx, vy, bx, by, obstacles, others, limits, thrust_scale):
    """`filtered` with the hazards from `around`, numbered in obstacles and others, then edges."""
    discs, rows = around(t, px, py, np.hypot(vx, vy), obstacles, others, limits, thrust_scale)
    x, y, hazard, spare = filtered(fx, fy, px, py, vx, vy, bx, by, discs, limits, thrust_scale)
    ex, ey, runner, room = escape(x, y, px, py, vx, vy, bx, by, discs, limits, thrust_scale)
    if runner >= 0:
        # a vehicle that passes an obstacle, with a part of CLEAR left, is not braked before it
        kept = standing(discs) if room > -CLEAR else discs
        x, y, hazard, spare = filtered(ex, ey, px, py, vx, vy, bx, by, kept, limits, thrust_scale)
        hazard = runner if hazard < 0 else hazard
        # no way out of its path: a stop is one of the flights tried, and not the best of them
        if room < 0.0 and reached_in(px, py, discs)[0] < URGENT:
            spare = np.inf
    if hazard >= discs.shape[0]:
        hazard += obstacles.shape[0] + others.shape[0] - discs.shape[0]
    elif hazard >= 0:
        hazard = rows[hazard]
    return x, y, hazard, spare


class Barrier:
    """One vehicle's safety filter, with the obstacles and the other vehicles.

    The flight chain calls `guarded` with `limits` and `obstacles`; a reference model, `filter`.
    """

    def __init__(
        self,
        params: BarrierParams,
        mass: float,
        force: float,
        period: float,
        half: tuple[float, float],
        obstacles: Mapping[str, Obstacle],
        keep: Mapping[str, float],
        effort: float | None = None,
        hard: Mapping[str, float] | None = None,
    ) -> None:
        """Guard a vehicle.

        Args:
            params: margins.
            mass: of the vehicle [kg].
            force: of its jets in every direction [N].
            period: jet period [s].
            half: largest distance of its centre from the middle in x and y, without a margin [m].
            obstacles: on the table.
            keep: per other vehicle, the distance of the centres at contact [m].
            effort: share of `force` for planned stops; None: from `params`.
            hard: per other vehicle, the largest deceleration by its jets in every direction
                [m/s^2]; None: they are like this one.
        """
        decel = (params.effort if effort is None else effort) * force / mass
        self.limits = Limits(
            mass, force, decel, force / mass, period, period + params.reaction_s, params.max_speed,
            half[0] - params.edge_margin, half[1] - params.edge_margin,
        )  # fmt: skip
        self._neighbours = {
            name: (reach + params.vehicle_margin, force / mass if hard is None else hard[name])
            for name, reach in keep.items()
        }
        self._names = list(obstacles)
        self.obstacles = discs_of([
            (*obstacle.position, *obstacle.velocity, obstacle.radius + params.obstacle_margin, 1.0)
            for obstacle in obstacles.values()
        ])  # fmt: skip
        self._guarded = with_fixed_types(guarded)
        self._met: tuple[str, ...] = ()  # the others at the last call
        self._met_limits = np.zeros((0, 2))

    def neighbour_limit(self, name: str) -> tuple[float, float]:
        """Distance of the centres to keep [m], and the other's largest deceleration [m/s^2]."""
        return self._neighbours[name]

    def neighbour_limits(self, names: Iterable[str]) -> Array:
        """`neighbour_limit` each, shape (n, 2)."""
        return np.array([self._neighbours[name] for name in names]).reshape(-1, 2)

    def filter(
        self, t: float, force: tuple[float, float], motion: tuple[float, ...],
        neighbours: Mapping[str, State], thrust_scale: float = 1.0,
    ) -> tuple[float, float, Intervention | None]:  # fmt: skip
        """The filtered force, and the change.

        Args:
            t: when the force begins to act [s].
            force: demanded mean over the coming period in W [N].
            motion: x, y [m], vx, vy [m/s], bias x, y [m/s^2] then.
            neighbours: newest state of each other vehicle.
            thrust_scale: of the jets' force at the present supply pressure.
        """
        rows = States.of(list(neighbours.values())).rows
        return self.filter_rows(t, force, motion, tuple(neighbours), rows, thrust_scale)

    def filter_rows(
        self, t: float, force: tuple[float, float], motion: tuple[float, ...],
        names: tuple[str, ...], states: Array, thrust_scale: float = 1.0,
    ) -> tuple[float, float, Intervention | None]:  # fmt: skip
        """`filter` with the states of the other vehicles `names` as rows, see rows.States."""
        (fx, fy), (px, py, vx, vy, bx, by) = force, motion
        if names != self._met:
            self._met, self._met_limits = names, self.neighbour_limits(names)
        others = np.empty((len(names), WIDTH))
        others[:, :2], others[:, 2:4] = states[:, 1:3], states[:, 4:6]
        others[:, [4, 6]], others[:, 5] = self._met_limits, states[:, 0]
        x, y, hazard, _ = self._guarded(
            t, fx, fy, px, py, vx, vy, bx, by,
            self.obstacles, others, self.limits, max(thrust_scale, LOWEST_SHARE),
        )  # fmt: skip
        if hazard < 0:
            return fx, fy, None
        return x, y, Intervention(x - fx, y - fy, *self.hazard(hazard, names))

    def hazard(self, row: int, neighbours: Iterable[str]) -> tuple[Hazard, str]:
        """Kind and name of a hazard by its row: obstacles, neighbours, edges, speed limit."""
        names = (*self._names, *neighbours)
        if row >= len(names):
            return EDGES[row - len(names)], ""
        return Hazard.OBSTACLE if row < len(self._names) else Hazard.VEHICLE, names[row]


def reaches(radii: Mapping[str, float], name: str) -> dict[str, float]:
    """Per other vehicle, the distance of the centres at which it touches `name` [m]."""
    return {other: radii[name] + radius for other, radius in radii.items() if other != name}


def discs_of(rows: Sequence[Sequence[float]], hard: float = np.inf) -> Array:
    """Rows for `filtered` from their first six numbers; works for an empty list.

    Args:
        rows: of hazards.
        hard: largest deceleration of each of them that is a vehicle [m/s^2].
    """
    return np.array([(*row, hard) for row in rows], dtype=float).reshape(-1, WIDTH)
