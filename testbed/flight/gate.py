"""The gate, last before the valves: closed unless every condition holds, and it says which fails.

Not armed, no pose yet, no setpoint yet: it waits. Anything else is a fault and stays until an
explicit reset, because a vehicle that has flown blind must not start firing again on its own.

A vehicle that brakes needs no setpoint, may be fast, and may do it on its own prediction for a
while, whatever poses it refuses meanwhile; everything else is asked of it, too.

`refuse` looks at the flight, `refuse_plan` at the plan itself, in the process that owns the port.
"""

import math
from typing import Annotated

from msgspec import Meta, Struct

from testbed.core.types import Health, Setpoint, State, ValveCommand, Wrench
from testbed.core.vehicle import NonNegative, Positive

EARLY = 1e-3  # a pose may seem to come from the future by so much: clocks are read twice [s]
# so far ahead a plan may be dated: a clock that was set back by less is the fault table's to name,
# and the plan is played from when it arrives
AHEAD = 0.05  # [s]


class GateParams(Struct, frozen=True, forbid_unknown_fields=True):
    """Limits of a healthy flight."""

    pose_timeout_s: Positive = 0.5
    # without a pose, when braking on what was fired: a whole stop from the filter's top speed.
    # It is a tenth wrong at the end; to shut the valves earlier leaves all of what is left
    blind_s: Positive = 4.0
    link_timeout_s: Positive = 2.0  # after the last setpoint has run out, at rest
    max_rejected: Annotated[int, Meta(ge=0)] = (
        30  # poses of late that the estimator did not believe
    )
    max_speed: Positive = 0.6  # [m/s]
    max_spin: Positive = 1.5  # [rad/s]
    fence_margin: NonNegative = 0.0  # between a vehicle's rim and the table's edge [m]


class Fence(Struct, frozen=True):
    """Where a vehicle's centre may be."""

    half_x: float  # [m]
    half_y: float  # [m]


def is_number(*values: float) -> bool:
    """Whether all values are finite and of a size that means something."""
    return math.hypot(*values) < 1e9  # false for nan and inf


class Gate:
    """One vehicle's gate."""

    def __init__(self, params: GateParams, fence: Fence) -> None:
        self._p, self._fence = params, fence
        self._fault: str | None = None

    @property
    def fault(self) -> str | None:
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
    ) -> str | None:
        """Why the valves must stay shut now, or None."""
        if self._fault:
            return self._fault
        if not armed:
            return "not armed"
        if not session_ok and not braking:
            return "setpoints are of another session"
        if state is None:
            return "no pose yet"
        if setpoint is None and not braking:
            return "no setpoint yet"
        self._fault = self._trouble(t, state, None if braking else setpoint, commanded_wrench)
        if self._fault is None and not is_number(health.supply_pressure):
            self._fault = "supply pressure is not a number"
        return self._fault

    def reset(self) -> None:
        """Forget the latched reason; an operator has looked."""
        self._fault = None

    def _trouble(
        self, t: float, state: State, setpoint: Setpoint | None, commanded_wrench: Wrench
    ) -> str | None:
        """`setpoint` is None when braking: then it does not matter."""
        p, pose, twist = self._p, state.pose, state.twist
        pose_timeout = (
            p.pose_timeout_s if setpoint is not None else max(p.blind_s, p.pose_timeout_s)
        )
        if not is_number(pose.x, pose.y, pose.theta, twist.vx, twist.vy, twist.omega):
            return "estimate is not a number"
        if not is_number(commanded_wrench.fx, commanded_wrench.fy, commanded_wrench.tau):
            return "law or tracker asks for something that is not a number"
        if not -EARLY < state.pose_age <= pose_timeout:
            return f"no pose for {state.pose_age:.2f} s (limit {pose_timeout} s)"
        if setpoint is not None and state.rejected > p.max_rejected:
            return f"{state.rejected} poses contradict the estimate"
        if setpoint is not None and not t - setpoint.valid_until <= p.link_timeout_s:
            waited = t - setpoint.valid_until
            return f"no setpoint for {waited:.2f} s (limit {p.link_timeout_s} s)"
        if abs(pose.x) > self._fence.half_x or abs(pose.y) > self._fence.half_y:
            return f"outside the fence at ({pose.x:.2f}, {pose.y:.2f}) m"
        fast = twist.vx**2 + twist.vy**2 > p.max_speed**2 or abs(twist.omega) > p.max_spin
        if fast and setpoint is not None:
            return f"too fast: ({twist.vx:.2f}, {twist.vy:.2f}) m/s, {twist.omega:.2f} rad/s"
        return None


def refuse_plan(command: ValveCommand, now: float, newest: int, longest: float) -> str | None:
    """Why a plan must not reach the board, or None: it is too old, too long, or not a plan.

    Args:
        command: the plan.
        now: on the clock that stamped it [s].
        newest: number of the plan sent last; an older one is a replay.
        longest: that a plan may last [s].
    """
    life = command.valid_until - command.issued_at
    if not 0.0 < life <= longest + EARLY:
        return f"a plan of {life:.3f} s (limit {longest} s)"
    if not command.issued_at <= now + AHEAD:
        return "a plan from the future"
    if not now < command.valid_until:
        return "a plan that has expired"
    if command.seq <= newest:
        return f"plan {command.seq} after plan {newest}"
    if len(command.on_us) != len(command.offset_us):
        return "a plan that does not say when its pulses begin"
    whole = round(1e6 * life) + 1  # rounded to microseconds
    for on, offset in zip(command.on_us, command.offset_us, strict=True):
        if not 0 <= on <= whole or not 0 <= offset <= whole - on:
            return f"a pulse of {on} us after {offset} us in a plan of {whole - 1} us"
    return None


def closed(command: ValveCommand) -> ValveCommand:
    """The same plan with every valve shut."""
    zeros = (0,) * len(command.on_us)
    return ValveCommand(command.seq, command.issued_at, command.valid_until, zeros, zeros)
