"""Kalman filter: estimates position, velocity and disturbance from late, noisy or missing poses.

Each coordinate is (position, velocity, bias): the bias is an acceleration that the fired jets do
not explain (tilt, thrust errors, hoses) and changes slowly. The two positions share their
covariance, because noise and model are the same; heading has its own.

The filter's state is at the capture time of the newest pose. Between captures, and from there to
the present through latency and drop-outs, it is driven by the wrench that the *fired* pulses give,
valve delay and ramp included. With known pulses a 20 ms old pose is as good as a new one.

The centre of mass is taken at the body's origin here; the few millimetres between them become
part of the bias.
"""

from collections.abc import Sequence
from itertools import chain
from typing import NamedTuple

import numpy as np
from msgspec import Struct
from msgspec.structs import astuple
from numpy.typing import NDArray

from testbed.core.compiled import compiled, settled
from testbed.core.jets import effect_matrix
from testbed.core.pulse import Timing, open_time, timing
from testbed.core.se2 import wrap, wrap_compiled
from testbed.core.table import Mocap
from testbed.core.types import Accel, Pose, PoseSample, State, Twist, ValveCommand
from testbed.core.vehicle import NonNegative, Positive, Vehicle

Array = NDArray[np.float64]

# A body cannot jump, but it can be pushed. Poses that contradict the filter but stay near its
# prediction mean a collision and are accepted after a while; a jump to another place never is.
# Three consecutive poses of a body lie on a line, apart from camera noise. Poses that contradict
# each other are not a push, and if they continue none is accepted. An identical pose is not
# accepted while the vehicle moves: it would look like a collision that stopped it.
PATIENCE = 5  # samples until poses near the prediction are accepted
ON_LINE = 3  # of them on the line through the two before
LINE = 4.0  # half width of that line [sigmas]
ROUGH = 11.0  # limit of the mean, in variances of the table file: 3.5 times its noise; healthy
# cameras stay below 4, and one ghost among good poses gives 10
AT_ONCE = 25.0  # largest contribution of a single pose to the mean
RECENT = 0.15  # share of the newest pose in the mean
BEND = 0.5  # allowed acceleration: five times that of the jets [m/s^2]
BEND_SPIN = 2.0  # [rad/s^2]
SLOW = 0.003  # below this a vehicle counts as not moving [m/s]
SLOW_SPIN = 0.02  # below this it counts as not turning [rad/s]
FORGIVEN = 2  # refusals cancelled by an accepted pose: noise is sometimes accepted by chance
JUMP = 0.05  # a larger error is a jump [m]
TURN = 0.1  # [rad]
SHOVE = 0.2  # velocity spread after a push [m/s]
SHOVE_SPIN = 0.5  # [rad/s]
SUB_STEP = 0.01  # [s] the wrench is averaged over this; at 0.1 m/s^2 that is 5 um


class EstimatorParams(Struct, frozen=True, forbid_unknown_fields=True):
    """Process noise. Defaults from the thrust spread and tilt of the shipped vehicle and table."""

    force_noise: Positive = 1.5e-3  # white acceleration, [m/s^2 / sqrt(Hz)]
    bias_walk: Positive = 4e-4  # random walk of the bias, [m/s^2 / sqrt(s)]
    torque_noise: Positive = 4e-3  # [rad/s^2 / sqrt(Hz)]
    spin_bias_walk: Positive = 1e-3  # [rad/s^2 / sqrt(s)]
    bias_spread: NonNegative = 3e-3  # of the bias at the start, one sigma [m/s^2]
    spin_bias_spread: NonNegative = 3e-3  # [rad/s^2]
    gate_sigma: Positive = 6.0  # innovations beyond this many sigmas are refused
    speed_spread: NonNegative = 0.005  # of the start "at rest", one sigma [m/s and rad/s]


class Fired(NamedTuple):
    """The last plans, newest last, as the wrench model needs them."""

    start: Array  # (m,) when each plan starts on the board [s]
    end: Array  # (m,) when it is replaced or over [s]
    on: Array  # (m, n) [s]
    offset: Array  # (m, n) [s]


@compiled
def note(fired, start, end, times_us):
    """Add a plan, in place; `times_us` are on, then offset in microseconds, shape (2 n,)."""
    last, jets = fired.start.shape[0] - 1, fired.on.shape[1]
    fired.end[last] = min(fired.end[last], start)
    for m in range(last):
        fired.start[m], fired.end[m] = fired.start[m + 1], fired.end[m + 1]
        fired.on[m] = fired.on[m + 1]
        fired.offset[m] = fired.offset[m + 1]
    fired.start[last], fired.end[last] = start, end
    for j in range(jets):
        fired.on[last, j] = 1e-6 * times_us[j]
        fired.offset[last, j] = 1e-6 * times_us[jets + j]


class Model(NamedTuple):
    """Constants of the vehicle for compiled code."""

    effect: Array  # (3, n), see jets.py
    mass: float  # [kg]
    inertia: float  # [kg m^2]
    droop: float  # see vehicle.Air
    valve: Timing


@compiled
def mean_wrench(fired, model, start, end):
    """Mean body wrench of the fired pulses over [start, end]: (fx, fy, tau)."""
    jets = model.effect.shape[1]
    flow = np.zeros(jets)
    open_jets = 0.0
    closing = model.valve.close_delay + model.valve.close_ramp
    for m in range(fired.start.shape[0]):
        if fired.start[m] >= end or fired.end[m] + closing <= start:
            continue
        for j in range(jets):
            if fired.on[m, j] > 0.0:
                up = fired.start[m] + fired.offset[m, j]
                down = min(up + fired.on[m, j], fired.end[m])
                flow[j] += open_time(up, down, model.valve, start, end)
    for j in range(jets):
        open_jets += flow[j]
    span = end - start
    share = 1.0 / (1.0 + model.droop * max(0.0, open_jets / span - 1.0))
    fx = fy = tau = 0.0
    for j in range(jets):
        level = share * flow[j] / span
        fx += model.effect[0, j] * level
        fy += model.effect[1, j] * level
        tau += model.effect[2, j] * level
    return fx, fy, tau


@compiled
def predict_covariance(cov, h, white, walk):
    """Advance one axis' covariance (3, 3) in place over `h`, exact for the triple integrator.

    Args:
        cov: of (position, velocity, bias).
        h: [s].
        white: spectral density of the acceleration noise [m^2/s^3].
        walk: spectral density of the bias walk [m^2/s^5].
    """
    h2, h3 = h * h, h * h * h
    pp, pv, pb = cov[0, 0], cov[0, 1], cov[0, 2]
    vv, vb, bb = cov[1, 1], cov[1, 2], cov[2, 2]
    # F cov F' with p' = p + h v + h^2/2 b, v' = v + h b, written out: it is called for every frame
    pp += 2.0 * h * pv + h2 * (vv + pb) + h3 * vb + 0.25 * h2 * h2 * bb
    pv += h * (vv + pb) + 1.5 * h2 * vb + 0.5 * h3 * bb
    pb += h * vb + 0.5 * h2 * bb
    vv += 2.0 * h * vb + h2 * bb
    vb += h * bb
    cov[0, 0] = pp + white * h3 / 3.0 + walk * h2 * h3 / 20.0
    cov[1, 1] = vv + white * h + walk * h3 / 3.0
    cov[2, 2] = bb + walk * h
    cov[0, 1] = cov[1, 0] = pv + white * h2 / 2.0 + walk * h2 * h2 / 8.0
    cov[0, 2] = cov[2, 0] = pb + walk * h3 / 6.0
    cov[1, 2] = cov[2, 1] = vb + walk * h2 / 2.0


@compiled
def predict_mean(x, fired, model, start, end):
    """Advance (x, y, theta, vx, vy, omega, bx, by, balpha) in place from `start` to `end`."""
    steps = int(np.ceil((end - start) / SUB_STEP - 1e-9))
    for k in range(steps):
        a = start + (end - start) * k / steps
        b = start + (end - start) * (k + 1) / steps
        h = b - a
        fx, fy, tau = mean_wrench(fired, model, a, b)
        theta = x[2] + 0.5 * h * x[5]
        c, s = np.cos(theta), np.sin(theta)
        accel = (
            (c * fx - s * fy) / model.mass + x[6],
            (s * fx + c * fy) / model.mass + x[7],
            tau / model.inertia + x[8],
        )
        for i in range(3):
            x[i] += h * (x[3 + i] + 0.5 * h * accel[i])
            x[3 + i] += h * accel[i]


@compiled
def correct(cov, noise):
    """Kalman gain of position, velocity and bias for a position of variance `noise`.

    `cov` (3, 3) is updated in place.
    """
    pp, pv, pb = cov[0, 0], cov[0, 1], cov[0, 2]
    by = 1.0 / (pp + noise)
    cov[1, 1] -= by * pv * pv
    cov[2, 2] -= by * pb * pb
    cov[1, 2] = cov[2, 1] = cov[1, 2] - by * pv * pb
    cov[0, 0] = pp * noise * by
    cov[0, 1] = cov[1, 0] = pv * noise * by
    cov[0, 2] = cov[2, 0] = pb * noise * by
    return pp * by, pv * by, pb * by


# columns of `clock`: time of the state [s], capture time of the newest accepted sample [s],
# recently refused samples (see FORGIVEN), refused samples in a row that are on a line, mean of
# `off_line`
T, NEWEST, REFUSED, AGREED, ROUGH_SO_FAR = range(5)


@compiled
def doubt(cov, error, shove):
    """Enlarge the covariance in place: something pushed the vehicle."""
    cov[0, 0] += error * error
    cov[1, 1] += shove * shove
    cov[2, 2] += (0.1 * shove) ** 2


@compiled
def off_line(last, sample, noise):
    """Squared distance of a pose from the line through the two before, in noise variances; mean 1.

    Args:
        last: the two, rows (t, x, y, theta), newest last; shifted in place.
        sample: this one, shape (4,).
        noise: variances of a pose, of position and heading.
    """
    span = last[1, 0] - last[0, 0]
    step = sample[0] - last[1, 0]
    known = span > 0.0
    ahead = step / span if known else 0.0
    dx = sample[1] - last[1, 1] - ahead * (last[1, 1] - last[0, 1])
    dy = sample[2] - last[1, 2] - ahead * (last[1, 2] - last[0, 2])
    before = wrap_compiled(last[1, 3] - last[0, 3])
    turn = wrap_compiled(sample[3] - last[1, 3] - ahead * before)
    for i in range(4):
        last[0, i], last[1, i] = last[1, i], sample[i]
    if not known:
        return 1.0
    width = 1.0 + (1.0 + ahead) ** 2 + ahead * ahead  # of three poses' noise
    bend = (0.5 * step * (span + step)) ** 2
    moved = 0.5 * (dx * dx + dy * dy) / (width * noise[0] + BEND * BEND * bend)
    return max(moved, turn * turn / (width * noise[1] + BEND_SPIN * BEND_SPIN * bend))


@compiled
def absorb(x, cov, cov_spin, clock, last, samples, now, fired, model, noise, walk, gate):
    """Run the filter over `samples`, shape (n, 4), changing x, cov, cov_spin, clock, last in place.

    A sample captured before the filter's time is late and is skipped, because newer ones have been
    used; so is a sample from after `now`, and one that is not finite.
    """
    t, newest, rough = clock[T], clock[NEWEST], clock[ROUGH_SO_FAR]
    refused, agreed = clock[REFUSED], clock[AGREED]
    for n in range(samples.shape[0]):
        captured = samples[n, 0]
        whole = np.isfinite(samples[n, 1] + samples[n, 2] + samples[n, 3])
        if not (t < captured <= now and whole):
            continue
        predict_mean(x, fired, model, t, captured)
        predict_covariance(cov, captured - t, walk[0], walk[1])
        predict_covariance(cov_spin, captured - t, walk[2], walk[3])
        t = captured
        same = np.hypot(x[3], x[4]) > SLOW or abs(x[5]) > SLOW_SPIN
        for i in range(1, 4):
            same = same and samples[n, i] == last[1, i]
        dx = samples[n, 1] - x[0]
        dy = samples[n, 2] - x[1]
        turn = wrap_compiled(samples[n, 3] - x[2])
        far = (dx * dx + dy * dy) / (cov[0, 0] + noise[0])
        twisted = turn * turn / (cov_spin[0, 0] + noise[1])
        off = off_line(last, samples[n], noise)
        rough += RECENT * (min(off, AT_ONCE) - rough)
        if same or rough > ROUGH or not (far <= gate * gate and twisted <= gate * gate):
            refused += 1
            near = np.hypot(dx, dy) <= JUMP and abs(turn) <= TURN
            agreed = agreed + 1 if near and off <= LINE * LINE and not same else 0
            if same or rough > ROUGH or refused < PATIENCE or agreed < ON_LINE:
                continue
            refused = 0
            doubt(cov, np.hypot(dx, dy), SHOVE)
            doubt(cov_spin, turn, SHOVE_SPIN)
        gain = correct(cov, noise[0])
        gain_spin = correct(cov_spin, noise[1])
        for i in range(3):
            x[3 * i] += gain[i] * dx
            x[3 * i + 1] += gain[i] * dy
            x[3 * i + 2] += gain_spin[i] * turn
        newest, agreed = captured, 0
        refused = max(0, refused - FORGIVEN)
    clock[T], clock[NEWEST], clock[ROUGH_SO_FAR] = t, newest, rough
    clock[REFUSED], clock[AGREED] = refused, agreed


@compiled
def ahead(x, clock, fired, model, until):
    """The state predicted to `until`, then capture time and refusals from `clock`, as one tuple."""
    y = x.copy()
    predict_mean(y, fired, model, clock[T], until)
    return y[0], y[1], y[2], y[3], y[4], y[5], y[6], y[7], y[8], clock[NEWEST], clock[REFUSED]


class Estimator:
    """One vehicle's filter and its memory of fired plans."""

    def __init__(
        self, params: EstimatorParams, vehicle: Vehicle, mocap: Mocap, memory: int = 8
    ) -> None:
        """`memory` is the number of stored plans; they must cover the longest pose loss."""
        self._params = params
        self._delay = vehicle.command_delay_s
        self._model = Model(
            effect_matrix(vehicle.jets, about=vehicle.com),
            vehicle.mass,
            vehicle.inertia,
            vehicle.air.droop,
            timing(vehicle.valve),
        )
        self._noise = np.array([mocap.noise**2, np.radians(mocap.noise_deg) ** 2]) + 1e-16
        self._walk = np.array(
            [
                params.force_noise**2,
                params.bias_walk**2,
                params.torque_noise**2,
                params.spin_bias_walk**2,
            ]
        )
        shape = (memory, len(vehicle.jets))
        self._fired = Fired(
            np.full(memory, -np.inf), np.full(memory, -np.inf), np.zeros(shape), np.zeros(shape)
        )
        self._x: Array | None = None
        self._cov = np.zeros((3, 3))
        self._cov_spin = np.zeros((3, 3))
        self._clock = np.array([0.0, 0.0, 0.0, 0.0, 1.0])
        self._last = np.zeros((2, 4))  # samples
        self._note, self._absorb = settled(note), settled(absorb)
        self._ahead = settled(ahead)

    def remember(self, command: ValveCommand) -> None:
        """Store a plan that was sent; it drives the prediction."""
        start, end = command.issued_at + self._delay, command.valid_until + self._delay
        self._note(self._fired, start, end, np.array(command.on_us + command.offset_us))

    def update(self, samples: Sequence[PoseSample], now: float) -> None:
        """Absorb poses in order of arrival; the first pose starts the filter at rest.

        A pose captured after `now` [s] has a wrong clock. It is skipped, because accepting it would
        make every later one appear late.
        """
        if not samples:
            return
        numbers = chain.from_iterable(map(astuple, samples))
        table = np.fromiter(numbers, np.float64, 4 * len(samples)).reshape(-1, 4)
        if self._x is None:
            table = table[np.isfinite(table).all(axis=1) & (table[:, 0] <= now)]
            if len(table) == 0:
                return
            self._start(table[0])
        assert self._x is not None
        self._absorb(
            self._x, self._cov, self._cov_spin, self._clock, self._last, table, now, self._fired,
            self._model, self._noise, self._walk, self._params.gate_sigma,
        )  # fmt: skip

    def _start(self, sample: Array) -> None:
        x = np.zeros(9)
        x[:3] = sample[1:]
        self._x = x
        self._clock[:] = sample[0], sample[0], 0.0, 0.0, 1.0
        self._last[:] = sample
        spread = self._params.speed_spread**2
        self._cov = np.diag([self._noise[0], spread, self._params.bias_spread**2])
        self._cov_spin = np.diag([self._noise[1], spread, self._params.spin_bias_spread**2])

    def predict(self, t: float, now: float) -> State | None:
        """The state at `t` >= the newest capture, or None before the first pose.

        Args:
            t: time of the prediction, usually a little ahead: when the next pulses take effect [s].
            now: present time, for the age of the pose [s].
        """
        if self._x is None:
            return None
        px, py, theta, vx, vy, omega, bx, by, spin, newest, refused = self._ahead(
            self._x, self._clock, self._fired, self._model, t
        )
        return State(
            t,
            Pose(px, py, wrap(theta)),
            Twist(vx, vy, omega),
            Accel(bx, by, spin),
            pose_age=now - newest,
            rejected=int(refused),
        )
