"""Tracker: follows a reference with the jets, without a steady-state error.

    force  = m (a_ref - bias + w^2 (p_ref - p) + 2 z w (v_ref - v))
    torque = I (alpha_ref - bias_alpha + ...)

The acceleration of the reference is fed forward. The estimator's bias replaces an integrator: it is
the acceleration that the fired jets do not explain, and it does not wind up when the jets saturate.
"""

from typing import NamedTuple

from msgspec import Struct

from testbed.core.compiled import compiled
from testbed.core.se2 import length, to_body_compiled, wrap_compiled
from testbed.core.vehicle import Positive, Vehicle
from testbed.flight.record import DEMAND, NO_SETPOINT, REFERENCE, record


class TrackerParams(Struct, frozen=True, forbid_unknown_fields=True):
    """Bandwidth and damping of the position and heading loops."""

    bandwidth: Positive = 0.8  # w [rad/s]
    damping: Positive = 1.0  # z
    heading_bandwidth: Positive = 1.5  # [rad/s]
    heading_damping: Positive = 1.0
    brake_decel: Positive = 0.03  # after setpoints have expired [m/s^2]


class Gains(NamedTuple):
    """Constants of the tracker for compiled code; units as in TrackerParams."""

    bandwidth: float
    damping: float
    heading_bandwidth: float
    heading_damping: float
    brake_decel: float
    mass: float  # [kg]
    inertia: float  # [kg m^2]
    com: tuple[float, float]  # centre of mass in B [m]
    period: float  # [s]


def gains_of(params: TrackerParams, vehicle: Vehicle, period: float) -> Gains:
    """The constants of a vehicle's tracker."""
    return Gains(
        params.bandwidth, params.damping, params.heading_bandwidth, params.heading_damping,
        params.brake_decel, vehicle.mass, vehicle.inertia,
        vehicle.com, period,
    )  # fmt: skip


MEMORY = record(
    stopping=int,  # 1: the setpoint has expired, and `stop` is flown
    stop=REFERENCE,
)


@compiled
def aim(p, m, state, setpoint, references, active):
    """The wrench (fx, fy, tau) for a setpoint; the reference that is flown goes to `active`.

    An expired setpoint is not flown: the vehicle comes to rest and waits for the next. The gate
    limits the wait.

    Args:
        p: Gains.
        m: MEMORY, changed in place.
        state: record.STATE.
        setpoint: record.SETPOINT.
        references: of a trajectory, rows in the order of record.REFERENCE, in order of time.
        active: record.REFERENCE.
    """
    if setpoint.kind == NO_SETPOINT or state.known == 0:
        return 0.0, 0.0, 0.0
    if state.t <= setpoint.valid_until:
        m.stopping = 0
    elif m.stopping == 0:
        m.stopping = 1
        brake(state, p.brake_decel, m.stop)
    if m.stopping == 1:
        copy(m.stop, active)
    elif setpoint.kind == DEMAND:
        return obey(p, state, setpoint)
    else:
        due(references, state.t, active)
    return track(p, state, active)


@compiled
def feedback(bandwidth, damping, error, rate_error):
    """Acceleration of a damped oscillator."""
    return bandwidth * (bandwidth * error + 2.0 * damping * rate_error)


@compiled
def track(p, state, ref):
    """Body wrench that follows a reference; both must be for the same instant."""
    w, z = p.bandwidth, p.damping
    ax = ref.ax - state.ax + feedback(w, z, ref.x - state.x, ref.vx - state.vx)
    ay = ref.ay - state.ay + feedback(w, z, ref.y - state.y, ref.vy - state.vy)
    fx, fy = to_body_compiled(state.theta, p.mass * ax, p.mass * ay)
    return about_origin(p, state, fx, fy, torque(p, state, ref.theta, ref.omega, ref.alpha))


@compiled
def obey(p, state, demand):
    """Body wrench of a demanded force, turned at the heading half a period ahead."""
    theta = state.theta + 0.5 * p.period * state.omega
    fx, fy = to_body_compiled(theta, demand.fx, demand.fy)
    tau = torque(p, state, demand.theta, demand.omega, demand.alpha)
    return about_origin(p, state, fx, fy, tau)


@compiled
def about_origin(p, state, fx, fy, tau):
    """Wrench that moves the origin as fx, fy would if it were the centre of mass.

    The centre is at c in B. The acceleration of the origin is less by alpha x c - omega^2 c.
    """
    alpha, spin2 = tau / p.inertia + state.alpha, state.omega * state.omega
    x, y = p.com
    return fx - p.mass * (alpha * y + spin2 * x), fy + p.mass * (alpha * x - spin2 * y), tau


@compiled
def torque(p, state, theta, omega, alpha):
    """Torque that holds a heading."""
    error = wrap_compiled(theta - state.theta)
    back = feedback(p.heading_bandwidth, p.heading_damping, error, omega - state.omega)
    return p.inertia * (alpha - state.alpha + back)


@compiled
def braking_wrench(p, state, decel):
    """Body wrench that stops the motion in one jet period, or reduces it as far as possible.

    It acts straight against the velocity, so that a vehicle with room to stop keeps it.

    Args:
        p: Gains.
        state: at the start of the period.
        decel: at most [m/s^2].
    """
    speed = length(state.vx, state.vy)
    rate = min(1.0 / p.period, decel / speed) if speed > 0.0 else 0.0
    ax, ay = -rate * state.vx - state.ax, -rate * state.vy - state.ay
    theta = state.theta + 0.5 * p.period * state.omega
    fx, fy = to_body_compiled(theta, p.mass * ax, p.mass * ay)
    slow = max(0.5, p.period)  # heading is stopped slowly: the jets are needed for the speed [s]
    return about_origin(p, state, fx, fy, p.inertia * (-state.omega / slow - state.alpha))


@compiled
def carry_forward(row, t, reference):
    """Write a reference, carried to another time at constant acceleration.

    Args:
        row: in the order of record.REFERENCE, shape (10,).
        t: [s].
        reference: record.REFERENCE.
    """
    dt, vx, vy, omega, ax, ay, alpha = t - row[0], row[4], row[5], row[6], row[7], row[8], row[9]
    reference.t = t
    reference.x = row[1] + dt * (vx + 0.5 * dt * ax)
    reference.y = row[2] + dt * (vy + 0.5 * dt * ay)
    reference.theta = row[3] + dt * (omega + 0.5 * dt * alpha)
    reference.vx, reference.vy, reference.omega = vx + dt * ax, vy + dt * ay, omega + dt * alpha
    reference.ax, reference.ay, reference.alpha = ax, ay, alpha


@compiled
def due(references, t, reference):
    """Write the reference for time `t`, carried forward from the last one before it."""
    k = references.shape[0] - 1
    while k > 0 and not references[k, 0] <= t + 1e-9:
        k -= 1
    carry_forward(references[k], t, reference)


@compiled
def brake(state, decel, reference):
    """Write the reference for a stop: at rest, where a smooth stop would end.

    Args:
        state: now.
        decel: of the stop, for its distance v^2 / 2a [m/s^2].
        reference: record.REFERENCE.
    """
    ahead = length(state.vx, state.vy) / (2.0 * decel)
    reference.t, reference.theta = state.t, state.theta
    reference.x, reference.y = state.x + ahead * state.vx, state.y + ahead * state.vy
    reference.vx = reference.vy = reference.omega = 0.0
    reference.ax = reference.ay = reference.alpha = 0.0


@compiled
def copy(one, other):
    """Write a reference to another place."""
    other.t, other.x, other.y, other.theta = one.t, one.x, one.y, one.theta
    other.vx, other.vy, other.omega = one.vx, one.vy, one.omega
    other.ax, other.ay, other.alpha = one.ax, one.ay, one.alpha
