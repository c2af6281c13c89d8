"""Kalman filter: estimates position, velocity and disturbance from late, noisy or missing poses.

Each coordinate is (position, velocity, bias): the bias is an acceleration that the fired jets do
not explain (tilt, thrust errors, hoses) and changes slowly. The two positions share their
covariance, because noise and model are the same; heading has its own.

The filter's state is at the capture time of the newest pose. Between captures, and from there to
the present through latency and drop-outs, it is driven by the wrench that the *fired* pulses give,
valve delay and ramp included. With known pulses a 20 ms old pose is as good as a new one.

Poses and the state are of the body's origin, and so are the setpoints. Forces and the bias move the
centre of mass, which the file places at c in the body. So a prediction goes there and back:

    x_c = x + r     v_c = v + omega x r     r = R(theta) c
"""

from typing import NamedTuple

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from testbed.core.compiled import compiled, pasted
from testbed.core.scratch import scratch
from testbed.core.se2 import velocity_at, wrap_compiled
from testbed.core.table import Mocap
from testbed.core.vehicle import NonNegative, Positive, Vehicle
from testbed.flight.fired import mean_wrench
from testbed.flight.pose_check import STILLS, is_still, note_step, off_line
from testbed.flight.record import record

Array = NDArray[np.float64]

# A body cannot jump, but it can be pushed. Poses that contradict the filter but stay near its
# prediction mean a collision and are accepted after a while; a jump to another place never is.
# Three consecutive poses of a body lie on a line, apart from camera noise. Poses that contradict
# each other are not a push, and if they continue none is accepted. An identical pose is not
# accepted while the vehicle moves: it would look like a collision that stopped it.
PATIENCE = 5  # samples until poses near the prediction are accepted
ON_LINE = 3  # of them on the line through the two before
LINE = 4.0  # half width of that line [sigmas]
ROUGH = 11.0  # limit of the mean, in variances of the table file: 3.3 times its noise; healthy
# cameras stay below 4, and one ghost among good poses gives 10
AT_ONCE = 25.0  # largest contribution of a single pose to the mean
RECENT = 0.15  # share of the newest pose in the mean
FORGIVEN = 2  # refusals cancelled by an accepted pose: noise is sometimes accepted by chance
JUMP = 0.05  # a larger error is a jump [m]
TURN = 0.1  # [rad]
SHOVE = 0.2  # velocity spread after a push [m/s]
SHOVE_SPIN = 0.5  # [rad/s]
SETTLED = 1.0  # from the first pose until the velocity is known [s]
USUAL = 0.005  # share of the newest pose in the mean noise of these cameras
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
def predict_mean(x, fired, model, start, end, flown):
    """Advance (x, y, theta, vx, vy, omega, bx, by, balpha) in place from `start` to `end`.

    `flown` is advanced, too: the impulse of each jet, in times of its whole thrust [s], and its
    integral [s^2], (2, n), if it does what is commanded.
    """
    steps = int(np.ceil((end - start) / SUB_STEP - 1e-9))
    flow = scratch(model.effect.shape[1])
    shift_point(x, model.com, 1.0)
    for k in range(steps):
        a = start + (end - start) * k / steps
        b = start + (end - start) * (k + 1) / steps
        h = b - a
        fx, fy, tau = mean_wrench(fired, model, flow, a, b)
        theta = x[2] + 0.5 * h * x[5]
        c, s = np.cos(theta), np.sin(theta)
        accel = (
            (c * fx - s * fy) / model.mass + x[6] - model.drag * x[3],
            (s * fx + c * fy) / model.mass + x[7] - model.drag * x[4],
            tau / model.inertia + x[8] - model.spin_drag * x[5],
        )
        for i in range(3):
            x[i] += h * (x[3 + i] + 0.5 * h * accel[i])
            x[3 + i] += h * accel[i]
        for j in range(flow.shape[0]):
            flown[1, j] += h * (flown[0, j] + 0.5 * flow[j])
            flown[0, j] += flow[j]
    shift_point(x, model.com, -1.0)


@compiled
def shift_point(x, offset, sign):
    """Move a state, in place, to the body's point that is `sign` times `offset` away in B [m]."""
    if offset[0] == 0.0 and offset[1] == 0.0:
        return
    c, s = np.cos(x[2]), np.sin(x[2])
    rx, ry = sign * (c * offset[0] - s * offset[1]), sign * (s * offset[0] + c * offset[1])
    x[0], x[1] = x[0] + rx, x[1] + ry
    x[3], x[4] = velocity_at(x[3], x[4], x[5], rx, ry)


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


class Filter(NamedTuple):
    """Variances of the filter; position first, heading second."""

    noise: Array  # of a pose [m^2, rad^2]
    walk: Array  # white noise and bias walk of the acceleration, see `predict_covariance`; (4,)
    start: Array  # bias of position and heading at the start (2,)
    start_speed: float  # of the start "at rest"
    gate: float  # innovations beyond this many sigmas are refused


def filter_of(params: EstimatorParams, vehicle: Vehicle, mocap: Mocap) -> Filter:
    """The variances for a vehicle seen by these cameras.

    An angular acceleration also moves an origin that is off the centre of mass.
    """
    lever = vehicle.com[0] ** 2 + vehicle.com[1] ** 2
    return Filter(
        np.array([mocap.noise**2, np.radians(mocap.noise_deg) ** 2]) + 1e-16,
        np.array([
            params.force_noise**2 + lever * params.torque_noise**2,
            params.bias_walk**2 + lever * params.spin_bias_walk**2,
            params.torque_noise**2, params.spin_bias_walk**2,
        ]),
        np.array([params.bias_spread**2, params.spin_bias_spread**2]),
        params.speed_spread**2,
        params.gate_sigma,
    )  # fmt: skip


MEMORY = record(
    started=int,  # 1: a pose has started the filter
    began=float,  # capture time of that pose [s]
    t=float,  # of the state [s]
    newest=float,  # capture time of the newest accepted sample [s]
    refused=float,  # recently refused samples, see FORGIVEN
    agreed=float,  # refused samples in a row that are on a line
    rough=float,  # mean of `off_line`
    usual=float,  # the same over more poses
    still=int,  # poses in a row that repeat the one before, but for a small share of the noise
    apart=(4,),  # first refused pose: time, and how far it was from the prediction
    prior=(3,),  # how far the last accepted pose was from its prediction
    since=float,  # capture time of the last accepted pose before it [s]
    step=(3,),  # how far this tick's accepted pose is elsewhere without a push [m, m, rad]
    going=(3,),  # velocity then [m/s, m/s, rad/s]
    bumped=float,  # change of velocity by a push at once, in this tick [m/s]
    x=(9,),  # x, y, theta, vx, vy, omega, bias of the three
    cov=(3, 3),  # of position, velocity, bias in x, and in y
    cov_spin=(3, 3),  # the same of the heading
    last=(2, 4),  # the newest two samples: t, x, y, theta
)


@compiled
def doubt(cov, error, shove):
    """Enlarge the covariance in place: something pushed the vehicle."""
    cov[0, 0] += error * error
    cov[1, 1] += shove * shove
    cov[2, 2] += (0.1 * shove) * (0.1 * shove)


@pasted
def begin_tick(m):
    """Forget what the last tick's poses did; `m` is MEMORY."""
    m.step[:] = m.bumped = 0.0


@compiled
def update(p, model, m, fired, flown, sample, now):
    """Absorb a pose; the first one starts the filter at rest. Returns whether it was accepted.

    Poses come in order of arrival.

    A pose captured after `now` has a wrong clock. It is skipped, because accepting it would make
    every later one appear late. A sample captured before the filter's time is late and is skipped,
    because newer ones have been used; so is one that is not finite.

    Args:
        p: Filter.
        model: of the vehicle.
        m: MEMORY, changed in place.
        fired: the last plans.
        flown: advanced, see `predict_mean`.
        sample: captured at [s], x [m], y [m], theta [rad].
        now: [s].
    """
    whole = np.isfinite(sample[0] + sample[1] + sample[2] + sample[3])
    if not (whole and sample[0] <= now):
        return False
    if m.started == 0:
        start(p, m, sample)
        return True
    return m.t < sample[0] and absorb(p, model, m, fired, flown, sample)


@compiled
def start(p, m, sample):
    """Start at rest at a pose."""
    m.started = 1
    m.t = m.newest = m.began = sample[0]
    m.refused = m.agreed = 0.0
    m.rough = m.usual = 1.0
    m.still, m.bumped, m.step[:], m.prior[:] = 0, 0.0, 0.0, 0.0
    m.x[:], m.cov[:], m.cov_spin[:] = 0.0, 0.0, 0.0
    m.x[0], m.x[1], m.x[2] = sample[1], sample[2], sample[3]
    for i in range(4):
        m.last[0, i] = m.last[1, i] = sample[i]
    m.cov[0, 0], m.cov[1, 1], m.cov[2, 2] = p.noise[0], p.start_speed, p.start[0]
    m.cov_spin[0, 0], m.cov_spin[1, 1], m.cov_spin[2, 2] = p.noise[1], p.start_speed, p.start[1]


@compiled
def absorb(p, model, m, fired, flown, sample):
    """Predict to a pose's capture time, then correct by it, or refuse it: return False."""
    x, cov, cov_spin, last, step = m.x, m.cov, m.cov_spin, m.last, sample[0] - m.t
    predict_mean(x, fired, model, m.t, sample[0], flown)
    predict_covariance(cov, step, p.walk[0], p.walk[1])
    predict_covariance(cov_spin, step, p.walk[2], p.walk[3])
    m.t = sample[0]
    same = is_still(m, sample, p.noise)
    dx = sample[1] - x[0]
    dy = sample[2] - x[1]
    turn = wrap_compiled(sample[3] - x[2])
    far = (dx * dx + dy * dy) / (cov[0, 0] + p.noise[0])
    twisted = turn * turn / (cov_spin[0, 0] + p.noise[1])
    off = off_line(last, sample, p.noise)
    m.rough += RECENT * (min(off, AT_ONCE) - m.rough)
    if m.still < STILLS:
        m.usual += USUAL * (min(off, ROUGH) - m.usual)
    limit = p.gate * p.gate
    if same or m.rough > ROUGH or not (far <= limit and twisted <= limit):
        m.refused += 1.0
        if m.since != m.newest:
            m.since = m.newest
            m.apart[0], m.apart[1], m.apart[2], m.apart[3] = m.t, dx, dy, turn
        near = np.hypot(dx, dy) <= JUMP and abs(turn) <= TURN
        m.agreed = m.agreed + 1.0 if near and off <= LINE * LINE and not same else 0.0
        if same or m.rough > ROUGH or m.refused < PATIENCE or m.agreed < ON_LINE:
            return False
        m.refused = 0.0
        if note_step(m, dx, dy, turn, cov[0, 0] + p.noise[0], cov_spin[0, 0] + p.noise[1]):
            x[0], x[1], x[2] = sample[1], sample[2], sample[3]  # and its velocity is known
            dx = dy = turn = 0.0
        else:
            if m.t - m.began > SETTLED:  # before, it may not have been at rest
                since = max(1e-3, m.t - m.apart[0])
                m.bumped = np.hypot(dx - m.apart[1], dy - m.apart[2]) / since
            doubt(cov, np.hypot(dx, dy), SHOVE)
            doubt(cov_spin, turn, SHOVE_SPIN)
    gain = correct(cov, p.noise[0])
    gain_spin = correct(cov_spin, p.noise[1])
    for i in range(3):
        x[3 * i] += gain[i] * dx
        x[3 * i + 1] += gain[i] * dy
        x[3 * i + 2] += gain_spin[i] * turn
    m.prior[0], m.prior[1], m.prior[2] = dx, dy, turn
    m.newest, m.agreed = m.t, 0.0
    m.refused = max(0.0, m.refused - FORGIVEN)
    return True


@compiled
def predict(model, m, fired, t, now, state):
    """Write the estimate for `t` to `state`; before the first pose, that it is not known.

    Args:
        model: of the vehicle.
        m: MEMORY.
        fired: the last plans.
        t: >= the newest capture, usually a little ahead: when the next pulses take effect [s].
        now: present time, for the age of the pose [s].
        state: record.STATE.
    """
    state.known = m.started
    if m.started == 0:
        return
    x, ahead = scratch(m.x.shape[0]), scratch((2, fired.gives.shape[0]))
    x[:], ahead[:] = m.x, 0.0
    predict_mean(x, fired, model, m.t, t, ahead)
    state.t = t
    state.x, state.y, state.theta = x[0], x[1], wrap_compiled(x[2])
    state.vx, state.vy, state.omega = x[3], x[4], x[5]
    state.ax, state.ay = x[6] - model.drag * x[3], x[7] - model.drag * x[4]
    state.alpha = x[8] - model.spin_drag * x[5]
    state.pose_age, state.rejected = now - m.newest, int(m.refused)
