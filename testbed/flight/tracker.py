"""Tracker: follow a reference with the jets, without a steady offset.

    force  = m (a_ref - bias + w^2 (p_ref - p) + 2 z w (v_ref - v))
    torque = I (alpha_ref - bias_alpha + ...)

The acceleration of the reference is fed forward, and the estimator's bias takes the place of an
integrator: it already is the acceleration that the fired jets do not explain, and it does not wind
up when the jets saturate.
"""

import math

from msgspec import Struct

from testbed.core.se2 import to_body, wrap
from testbed.core.types import Accel, Demand, Pose, Reference, State, Trajectory, Twist, Wrench
from testbed.core.vehicle import Positive, Vehicle


class TrackerParams(Struct, frozen=True, forbid_unknown_fields=True):
    """Bandwidth and damping of the position and heading loops."""

    bandwidth: Positive = 0.8  # w [rad/s]
    damping: Positive = 1.0  # z
    heading_bandwidth: Positive = 1.5  # [rad/s]
    heading_damping: Positive = 1.0
    brake_decel: Positive = 0.03  # when setpoints stop coming [m/s^2]


def _feedback(bandwidth: float, damping: float, error: float, rate_error: float) -> float:
    return bandwidth * (bandwidth * error + 2.0 * damping * rate_error)


class Tracker:
    """Wrench for one vehicle."""

    def __init__(self, params: TrackerParams, vehicle: Vehicle) -> None:
        self._p = params
        self._mass, self._inertia = vehicle.mass, vehicle.inertia

    def track(self, state: State, reference: Reference) -> Wrench:
        """Body wrench that follows `reference`; both must be for the same instant."""
        p, pose, twist, bias = self._p, state.pose, state.twist, state.bias
        ref, ref_twist, accel = reference.pose, reference.twist, reference.accel
        w, z = p.bandwidth, p.damping
        ax = accel.ax - bias.ax + _feedback(w, z, ref.x - pose.x, ref_twist.vx - twist.vx)
        ay = accel.ay - bias.ay + _feedback(w, z, ref.y - pose.y, ref_twist.vy - twist.vy)
        fx, fy = to_body(pose.theta, self._mass * ax, self._mass * ay)
        return Wrench(fx, fy, self._torque(state, ref.theta, ref_twist.omega, accel.alpha))

    def obey(self, state: State, demand: Demand, period: float) -> Wrench:
        """Body wrench of a demanded force, turned at the heading half a period ahead."""
        theta = state.pose.theta + 0.5 * period * state.twist.omega
        fx, fy = to_body(theta, demand.fx_w, demand.fy_w)
        return Wrench(fx, fy, self._torque(state, demand.theta, demand.omega, demand.alpha))

    def _torque(self, state: State, theta: float, omega: float, alpha: float) -> float:
        w, z = self._p.heading_bandwidth, self._p.heading_damping
        error = wrap(theta - state.pose.theta)
        back = _feedback(w, z, error, omega - state.twist.omega)
        return self._inertia * (alpha - state.bias.alpha + back)


def braking_wrench(state: State, vehicle: Vehicle, decel: float, period: float) -> Wrench:
    """Body wrench that takes the motion out: all of it in one jet period, or as much as can be.

    Straight against the velocity, so that a vehicle that could stop before it began still can.

    Args:
        state: at the start of the period.
        vehicle: mass and inertia.
        decel: at most [m/s^2].
        period: [s].
    """
    twist, bias = state.twist, state.bias
    speed = math.hypot(twist.vx, twist.vy)
    rate = min(1.0 / period, decel / speed) if speed > 0.0 else 0.0
    ax, ay = -rate * twist.vx - bias.ax, -rate * twist.vy - bias.ay
    theta = state.pose.theta + 0.5 * period * twist.omega
    fx, fy = to_body(theta, vehicle.mass * ax, vehicle.mass * ay)
    slow = max(0.5, period)  # [s] heading can wait, the jets are needed for the speed
    return Wrench(fx, fy, vehicle.inertia * (-twist.omega / slow - bias.alpha))


def carry_forward(reference: Reference, t: float) -> Reference:
    """The same reference at another time, at constant acceleration."""
    dt = t - reference.t
    pose, twist, accel = reference.pose, reference.twist, reference.accel
    return Reference(
        t,
        Pose(
            pose.x + dt * (twist.vx + 0.5 * dt * accel.ax),
            pose.y + dt * (twist.vy + 0.5 * dt * accel.ay),
            pose.theta + dt * (twist.omega + 0.5 * dt * accel.alpha),
        ),
        Twist(twist.vx + dt * accel.ax, twist.vy + dt * accel.ay, twist.omega + dt * accel.alpha),
        accel,
    )


def due(trajectory: Trajectory, t: float) -> Reference:
    """The trajectory's reference for time `t`, carried forward from the last one before it."""
    references = trajectory.references
    for reference in reversed(references):
        if reference.t <= t + 1e-9:
            return carry_forward(reference, t)
    return carry_forward(references[0], t)


def brake(state: State, decel: float) -> Reference:
    """Come to rest and stay: a standing reference where a smooth stop would end.

    Args:
        state: now.
        decel: of the stop, for its distance v^2 / 2a [m/s^2].
    """
    pose, twist = state.pose, state.twist
    ahead = math.hypot(twist.vx, twist.vy) / (2.0 * decel)
    return Reference(
        state.t,
        Pose(pose.x + ahead * twist.vx, pose.y + ahead * twist.vy, pose.theta),
        Twist(0.0, 0.0, 0.0),
        Accel(0.0, 0.0, 0.0),
    )
