"""The gate, the last check before the valves: closed unless every condition holds.

It gives the reason when it is closed. Not armed, no pose yet, no setpoint yet: it waits. Any other
reason is a fault and stays until an explicit reset, because a vehicle that has flown blind must not
start firing again on its own.

A braking vehicle needs no setpoint, may be fast, and may use its own prediction for a while, also
when it refuses poses; all other conditions apply.

`refuse` checks the flight, `refuse_plan` checks the plan, in the process that owns the port.
"""

import math
from typing import Annotated

from msgspec import Meta, Struct

from testbed.core.codes import InhibitReason, Refusal
from testbed.core.types import Health, Setpoint, State, ValveCommand, Wrench
from testbed.core.vehicle import NonNegative, Positive

EARLY = 1e-3  # a pose may seem to be this far in the future: clocks are read twice [s]
# a plan's stamp may be this far ahead: the fault table detects a clock that was set back by less,
# and the board starts the plan on arrival
AHEAD = 0.05  # [s]


class GateParams(Struct, frozen=True, forbid_unknown_fields=True):
    """Limits of a healthy flight."""

    pose_timeout_s: Positive = 0.5
    # without a pose, while braking on the fired pulses: a full stop from the filter's top speed.
    # The estimate is 10 % wrong at the end; shutting the valves earlier would leave more speed
    blind_s: Positive = 4.0
    link_timeout_s: Positive = 2.0  # after the last setpoint has expired, at rest
    max_rejected: Annotated[int, Meta(ge=0)] = 30  # recent poses that the estimator refused
    max_speed: Positive = 0.6  # [m/s]
    max_spin: Positive = 1.5  # [rad/s]
    fence_margin: NonNegative = 0.0  # between a vehicle's rim and the table's edge [m]


class Fence(Struct, frozen=True):
    """Allowed area of a vehicle's centre, from the middle of the table."""

    half_x: float  # [m]
    half_y: float  # [m]


def is_number(*values: float) -> bool:
    """Whether all values are finite and their norm is below 1e9."""
    return math.hypot(*values) < 1e9  # false for nan and inf


class Gate:
    """One vehicle's gate."""

    def __init__(self, params: GateParams, fence: Fence) -> None:
        self._p, self._fence = params, fence
        self._fault: Refusal | None = None

    @property
    def fault(self) -> Refusal | None:
        """The latched reason."""
        return self._fault

    def refuse(
        self,
        t: float,
        armed: bool,
        state: State | None,
        setpoint: Setpoint | None,
        commanded_wrench: Wrench,
        health: Health,
        *,
        session_ok: bool = True,
        braking: bool = False,
    ) -> Refusal | None:
        """Reason why the valves must stay shut now; None: they may open."""
        if self._fault:
            return self._fault
        if not armed:
            return Refusal(InhibitReason.NOT_ARMED)
        if not session_ok and not braking:
            return Refusal(InhibitReason.OTHER_SESSION)
        if state is None:
            return Refusal(InhibitReason.NO_POSE_YET)
        if setpoint is None and not braking:
            return Refusal(InhibitReason.NO_SETPOINT_YET)
        self._fault = self._trouble(t, state, None if braking else setpoint, commanded_wrench)
        if self._fault is None and not is_number(health.supply_pressure):
            self._fault = Refusal(InhibitReason.SUPPLY_NOT_FINITE)
        return self._fault

    def reset(self) -> None:
        """Clear the latched reason after the operator's reset."""
        self._fault = None

    def _trouble(
        self, t: float, state: State, setpoint: Setpoint | None, commanded_wrench: Wrench
    ) -> Refusal | None:
        """Reason to latch a fault; `setpoint` is None when braking and is then not checked."""
        p, pose, twist = self._p, state.pose, state.twist
        pose_timeout = (
            p.pose_timeout_s if setpoint is not None else max(p.blind_s, p.pose_timeout_s)
        )
        if not is_number(pose.x, pose.y, pose.theta, twist.vx, twist.vy, twist.omega):
            return Refusal(InhibitReason.ESTIMATE_NOT_FINITE)
        if not is_number(commanded_wrench.fx, commanded_wrench.fy, commanded_wrench.tau):
            return Refusal(InhibitReason.DEMAND_NOT_FINITE)
        if not -EARLY < state.pose_age <= pose_timeout:
            return Refusal(InhibitReason.POSE_TOO_OLD, (state.pose_age, pose_timeout))
        if setpoint is not None and state.rejected > p.max_rejected:
            return Refusal(InhibitReason.POSES_REJECTED, (state.rejected,))
        if setpoint is not None and not t - setpoint.valid_until <= p.link_timeout_s:
            waited = t - setpoint.valid_until
            return Refusal(InhibitReason.SETPOINT_TOO_OLD, (waited, p.link_timeout_s))
        if abs(pose.x) > self._fence.half_x or abs(pose.y) > self._fence.half_y:
            return Refusal(InhibitReason.OUTSIDE_FENCE, (pose.x, pose.y))
        fast = twist.vx**2 + twist.vy**2 > p.max_speed**2 or abs(twist.omega) > p.max_spin
        if fast and setpoint is not None:
            return Refusal(InhibitReason.TOO_FAST, (twist.vx, twist.vy, twist.omega))
        return None


def refuse_plan(command: ValveCommand, now: float, newest: int, longest: float) -> Refusal | None:
    """Reason why a plan must not reach the board (too old, too long, invalid); None: it may.

    Args:
        command: the plan.
        now: on the clock that stamped it [s].
        newest: number of the plan sent last; an older one is a replay.
        longest: longest plan [s].
    """
    life = command.valid_until - command.issued_at
    if not 0.0 < life <= longest + EARLY:
        return Refusal(InhibitReason.PLAN_TOO_LONG, (life, longest))
    if not command.issued_at <= now + AHEAD:
        return Refusal(InhibitReason.PLAN_FROM_FUTURE)
    if not now < command.valid_until:
        return Refusal(InhibitReason.PLAN_EXPIRED)
    if command.seq <= newest:
        return Refusal(InhibitReason.PLAN_REPLAYED, (command.seq, newest))
    if len(command.on_us) != len(command.offset_us):
        return Refusal(InhibitReason.PLAN_INCOMPLETE)
    whole = round(1e6 * life) + 1  # rounded to microseconds
    for on, offset in zip(command.on_us, command.offset_us, strict=True):
        if not 0 <= on <= whole or not 0 <= offset <= whole - on:
            return Refusal(InhibitReason.PULSE_INVALID, (on, offset, whole - 1))
    return None


def closed(command: ValveCommand) -> ValveCommand:
    """The same plan with every valve shut."""
    zeros = (0,) * len(command.on_us)
    return ValveCommand(command.seq, command.issued_at, command.valid_until, zeros, zeros)
