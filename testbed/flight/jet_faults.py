r"""Which jet does not do what it is told, from what the commands explain of the motion.

From one look to the next the estimate of momentum moves by more than plan and slope say: that is
the residual e. Three kinds of things explain it:

    z_i   what no file knows exactly: the thrust of every jet, the centre of mass, the slope here.
          Each is zero but for its tolerance.
    x_j   jet j leaks, or is stuck open: it pushes while it is not commanded
    x_j   jet j gives too little, or is stuck shut: it pushes less while it is commanded

A suspicion is one x_j, of any size b, that began some time ago and holds since. With the noise of e
as the unit and L L' = z'z + 1 / tolerances^2, the logarithm of how much likelier it makes e is

    S_j = x_j'e - (L^-1 z'x_j)'(L^-1 z'e),   N_j = x_j'x_j - |L^-1 z'x_j|^2
    b = S_j / N_j within its bounds,         gain = b S_j - b^2 N_j / 2

and sqrt(2 gain) is how many standard deviations jet j is from one that is well. A jet that leaks
makes the vehicle fire the one opposite, and in the mean it looks as if that one gave nothing. What
tells them apart is which of them explains more: a leak pushes all the time, and before the other is
commanded; too little shows only while the jet is commanded.

What the estimate shows of a push comes late, so z and x are delayed alike (see response.py).
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from testbed.core.compiled import compiled, settled
from testbed.core.jets import effect_matrix
from testbed.core.table import Table, Tilt
from testbed.core.types import State
from testbed.core.vehicle import Vehicle
from testbed.flight.estimator import EstimatorParams
from testbed.flight.response import response

Array = NDArray[np.float64]

LOOK = 0.1  # [s] faster ticks are taken together: their residuals are not independent
MEMORY = 10.0  # [s] what is older counts for less
SETTLING = 20.0  # [s] of the mean of what no jet explains: the slope
BLOCK = 0.3  # [s] a fault is said to have begun at the start of one of these
BLOCKS = 25
BEGUN = (1, 2, 3, 4, 5, 7, 10, 14, 24)  # how many whole blocks ago; the look at hand is in block 0
THRUST = 0.05  # of a jet, relative, one sigma: files that promise more are not believed
BALANCE = 0.01  # of the centre of mass, one sigma [m]: the same
SLOPE = 2e-3  # of a table, before anything is known of it [m/s^2]
BUMPS = 5e-4  # by how much it differs from place to place [m/s^2]
SPREAD = 1.5e-3  # of a velocity residual at the start, one sigma [m/s]
SPIN_SPREAD = 5e-3  # [rad/s]
BELIEVED = 30.0  # looks that the spread at the start counts for
WHITE = 2.6  # variance of the difference of two residuals, in variances of one
OUTLIER = 9.0  # variances: more in a look is no noise
HARDEST = 3.0  # jets: more in a look is a shove
MOST = 1.2  # times its thrust that a jet can leak
ENOUGH = 0.3  # of its thrust that a jet has to lack,
TRACE = 0.05  # and to leak: less is no fault
CLEAR = 3.0  # the one suspicion is e^3 times likelier than the other


class Known(NamedTuple):
    """The vehicle in numbers."""

    effect: Array  # acceleration by each fully open jet in B, (3, n) [m/s^2, rad/s^2]
    gyration: float  # mass over inertia [1/m^2]
    droop: float  # see vehicle.Air
    sure: Array  # 1 / tolerance^2 of z, (m,)
    slope: float  # [m/s^2], one sigma
    bumps: float  # [m/s^2], one sigma
    shown: Array  # see response.py, (looks, 2)
    most: Array  # that a residual may be, push and turn [m/s, rad/s]
    period: float  # [s]


class Heard(NamedTuple):
    """What is remembered, changed in place."""

    recent: Array  # z and leaks of the last looks, not yet delayed, (looks, m + n, 3)
    told: Array  # z'z, and z'e as the last column, (m, m + 1)
    blocks: Array  # of leaks and jets: x'z, x'x, x'e, (BLOCKS, 2 n, m + 2)
    spread: Array  # variance of the residual, push and turn, (2,)
    bias: Array  # slow mean of what the jets do not explain [m/s^2], (2,)
    last: Array  # residual before, (3,)


@compiled
def residual(before, now, duty, thrust_scale, known, heard, look):
    """What the plans do not explain since the last look, (3,), and all that might, (m + n, 3)."""
    n, period, shown = duty.shape[0], known.period, known.shown
    looks, m = shown.shape[0], duty.shape[0] + 4
    theta = before[0] + 0.5 * period * before[3]
    c, s = np.cos(theta), np.sin(theta)
    open_jets = 0.0
    for j in range(n):
        open_jets += max(0.0, duty[j])
    level = period * thrust_scale / (1.0 + known.droop * max(0.0, open_jets - 1.0))
    fresh = heard.recent[look % looks]
    fresh[:] = 0.0
    e = np.empty(3)
    e[0] = now[1] - before[1] - period * heard.bias[0]
    e[1] = now[2] - before[2] - period * heard.bias[1]
    e[2] = now[3] - before[3]
    push_x = push_y = 0.0
    for j in range(n):
        ax, ay = known.effect[0, j], known.effect[1, j]
        whole = (level * (c * ax - s * ay), level * (s * ax + c * ay), level * known.effect[2, j])
        idle = 1.0 - min(max(duty[j], 0.0), 1.0)
        for axis in range(3):
            fresh[j, axis] = duty[j] * whole[axis]
            fresh[m + j, axis] = idle * whole[axis]
            e[axis] -= duty[j] * whole[axis]
        push_x += duty[j] * ax
        push_y += duty[j] * ay
    fresh[n, 2] = -level * push_y * known.gyration  # the centre of mass is further along x, y
    fresh[n + 1, 2] = level * push_x * known.gyration
    fresh[n + 2, 0] = fresh[n + 3, 1] = period
    for axis in range(3):
        most = known.most[0] if axis < 2 else known.most[1]
        e[axis] = min(max(e[axis], -most), most)
    late = np.zeros((m + n, 3))
    for q in range(looks):
        then = heard.recent[(look - q) % looks]
        for i in range(m + n):
            late[i, 0] += shown[q, 0] * then[i, 0]
            late[i, 1] += shown[q, 0] * then[i, 1]
            late[i, 2] += shown[q, 1] * then[i, 2]
    return e, late


@compiled
def listen(e, x, heard, look, keep):
    """Learn slope, noise and how all that might explain e goes with it, in place."""
    spread, last, m = heard.spread, heard.last, heard.told.shape[0]
    n = m - 4
    trust = max(1.0 - keep, 1.0 / (look + BELIEVED))
    push = 0.5 * ((e[0] - last[0]) ** 2 + (e[1] - last[1]) ** 2) / WHITE
    spread[0] += trust * (min(push, OUTLIER * spread[0]) - spread[0])
    spread[1] += trust * (min((e[2] - last[2]) ** 2 / WHITE, OUTLIER * spread[1]) - spread[1])
    last[:] = e
    weight = (1.0 / spread[0], 1.0 / spread[0], 1.0 / spread[1])
    told, blocks = heard.told, heard.blocks
    told *= keep
    blocks *= keep
    for i in range(m + n):
        a, b, c = x[i, 0] * weight[0], x[i, 1] * weight[1], x[i, 2] * weight[2]
        explains = a * e[0] + b * e[1] + c * e[2]
        if i < m:
            told[i, m] += explains
            for k in range(m):
                told[i, k] += a * x[k, 0] + b * x[k, 1] + c * x[k, 2]
        if i < n or i >= m:  # what may be suspected: the jets, and their leaks
            row = heard.blocks[0, i if i < n else i - 4]
            for k in range(m):
                row[k] += a * x[k, 0] + b * x[k, 1] + c * x[k, 2]
            row[m] += a * x[i, 0] + b * x[i, 1] + c * x[i, 2]
            row[m + 1] += explains


@compiled
def factor(known, heard, look):
    """L of z'z + 1 / tolerances^2, with 1 / L_ii in its diagonal, (m, m), and L^-1 z'e, (m,)."""
    told, m = heard.told, heard.told.shape[0]
    least, y = np.zeros((m, m)), np.empty(m)
    slope = 1.0 / (known.bumps**2 + known.slope**2 / (1.0 + 0.1 * look))
    for i in range(m):
        for k in range(i + 1):
            total = told[i, k]
            if i == k:
                total += slope if i >= m - 2 else known.sure[i]
            for q in range(k):
                total -= least[i, q] * least[k, q]
            least[i, k] = 1.0 / np.sqrt(total) if i == k else total * least[k, k]
        total = told[i, m]
        for q in range(i):
            total -= least[i, q] * y[q]
        y[i] = total * least[i, i]
    return least, y


@compiled
def suspect(row, least, y, low, high):
    """Size of a suspicion within its bounds, and its gain; `row` is x'z, x'x, x'e."""
    m = y.shape[0]
    own, fits = row[m], row[m + 1]
    root = np.empty(m)
    for i in range(m):
        total = row[i]
        for q in range(i):
            total -= least[i, q] * root[q]
        root[i] = total * least[i, i]
        own -= root[i] * root[i]
        fits -= root[i] * y[i]
    if own <= 1e-6 * row[m] or own < 1e-9:
        return 0.0, 0.0
    size = min(max(fits / own, low), high)
    return size, size * fits - 0.5 * size * size * own


@compiled
def weigh(before, now, duty, thrust_scale, known, heard, look, block, keep, counts):
    """Add one look, in place, and say which suspicion is the best of each kind.

    Args:
        before: theta, vx, vy, omega at the last look, shape (4,).
        now: the same at this one.
        duty: share of the time since then for which each jet flowed, shape (n,).
        thrust_scale: of the thrust that the supply gave.
        known: the vehicle.
        heard: what is remembered.
        look: number of this one.
        block: looks in a block.
        keep: share of what is remembered that is kept.
        counts: false: the poses were not to be trusted a moment ago, this look is only noted.

    Returns:
        jet, size, gain of the best leak, then of the jet that most likely gives too little.
    """
    e, x = residual(before, now, duty, thrust_scale, known, heard, look)
    n, blocks = duty.shape[0], heard.blocks
    best, size, gain = np.zeros(2, dtype=np.int64), np.zeros(2), np.zeros(2)
    if not counts:
        return best[0], size[0], gain[0], best[1], size[1], gain[1]
    settling = max(1.0 / look, known.period / SETTLING)
    for axis in range(2):
        heard.bias[axis] += settling * e[axis] / known.period
    if look % block == 0:  # the oldest two are one from now on: that is what is left of all before
        blocks[-2] += blocks[-1]
        blocks[1:] = blocks[:-1].copy()
        blocks[0] = 0.0
    listen(e, x, heard, look, keep)
    least, y = factor(known, heard, look)
    since = np.zeros(blocks.shape[1:])
    for k in range(blocks.shape[0]):
        since += blocks[k]
        if k not in BEGUN:
            continue
        for h in range(2 * n):
            kind = 0 if h >= n else 1
            low, high = (0.0, MOST) if kind == 0 else (-1.0, 0.0)
            b, found = suspect(since[h], least, y, low, high)
            if found > gain[kind]:
                best[kind], size[kind], gain[kind] = h - n if kind == 0 else h, b, found
    return best[0], size[0], gain[0], best[1], -size[1], gain[1]


class Suspicion(NamedTuple):
    """The best of its kind."""

    jet: int = 0
    size: float = 0.0  # share of the jet's thrust
    gain: float = 0.0  # in logarithm of likelihood

    @property
    def sigmas(self) -> float:
        """Standard deviations from a vehicle that is well."""
        return float(np.sqrt(2.0 * self.gain))


def slopes(tilt: Tilt) -> tuple[float, float]:
    """By how much a table slopes, and by how much that differs from place to place [m/s^2]."""
    nodes = np.array([node for row in tilt.map for node in row] or [(0.0, 0.0)])
    mean = nodes.mean(axis=0)
    bumps = float(np.hypot(*(nodes - mean).T).max())
    return max(SLOPE, float(np.hypot(*(mean + tilt.uniform)))), max(BUMPS, bumps)


class JetFaultDetector:
    """One vehicle's jets in the light of its motion."""

    def __init__(
        self, vehicle: Vehicle, period: float, estimator: EstimatorParams, table: Table
    ) -> None:
        """`period` is that of the ticks [s]; of the table cameras and slope count."""
        self._ticks = max(1, round(LOOK / period))  # in a look
        period *= self._ticks
        shown = response(estimator, vehicle, table.mocap, period)
        n = len(vehicle.jets)
        m = n + 4
        scale = np.array([[vehicle.mass], [vehicle.mass], [vehicle.inertia]])
        effect = effect_matrix(vehicle.jets, about=vehicle.com) / scale
        tolerance = np.full(m, max(THRUST, vehicle.tolerance.thrust))
        tolerance[n:] = max(BALANCE, vehicle.tolerance.com)
        push = float(np.hypot(effect[0], effect[1]).max())
        turn = float(np.abs(effect[2]).max())
        self._known = Known(
            effect, vehicle.mass / vehicle.inertia, vehicle.air.droop, tolerance**-2.0,
            *slopes(table.tilt), np.ascontiguousarray(shown),
            HARDEST * period * np.array([push, turn]), period,
        )  # fmt: skip
        self._heard = Heard(
            np.zeros((len(shown), m + n, 3)), np.zeros((m, m + 1)),
            np.zeros((BLOCKS, 2 * n, m + 2)), np.array([SPREAD**2, SPIN_SPREAD**2]),
            np.zeros(2), np.zeros(3),
        )  # fmt: skip
        self._keep, self._block = 1.0 - min(0.5, period / MEMORY), max(1, round(BLOCK / period))
        self._before: Array | None = None
        self._duty, self._noted = np.zeros(n), 0  # sum over the ticks since the last look
        self._look, self._wait = 0, 0
        self._leak, self._weak = Suspicion(), Suspicion()
        self._weigh = settled(weigh)

    def look(self, state: State, duty: Array, thrust_scale: float) -> None:
        """Note a tick: the estimate, and for which share of it each jet flowed until then."""
        self._duty += duty
        self._noted += 1
        if self._before is not None and self._noted < self._ticks:
            return
        twist = state.twist
        now = np.array((state.pose.theta, twist.vx, twist.vy, twist.omega))
        if self._before is not None:
            self._look += 1
            self._wait = max(0, self._wait - 1)
            found = self._weigh(
                self._before, now, self._duty / self._ticks, thrust_scale, self._known, self._heard,
                self._look, self._block, self._keep, self._wait == 0,
            )  # fmt: skip
            self._leak, self._weak = Suspicion(*found[:3]), Suspicion(*found[3:])
        self._before = now
        self._duty, self._noted = np.zeros(len(duty)), 0

    def pause(self) -> None:
        """Learn nothing from poses that cannot be trusted, nor until they are worked in."""
        self._before, self._wait = None, len(self._known.shown)
        self._leak, self._weak = Suspicion(), Suspicion()
        self._heard.recent[:] = 0.0

    @property
    def open(self) -> Suspicion:
        """Which jet pushes without a command, where nothing else explains it."""
        sure = self._leak.gain > self._weak.gain + CLEAR
        return self._leak if sure and self._leak.size > TRACE else Suspicion()

    @property
    def weak(self) -> Suspicion:
        """Which jet gives too little, where nothing else explains it."""
        sure = self._weak.gain >= self._leak.gain + CLEAR
        return self._weak if sure and self._weak.size > ENOUGH else Suspicion()

    @property
    def either(self) -> tuple[Suspicion, Suspicion]:
        """A jet that may leak, and the one that gives too little if the first does not leak."""
        may = self._leak.gain > self._weak.gain - CLEAR and self._leak.size > TRACE
        return (self._leak, self._weak) if may else (Suspicion(), Suspicion())
