"""The gate: valves stay shut unless every condition of a healthy flight holds.

It gives the reason when it is closed. Not armed, setpoints of another session, no pose yet, no
setpoint yet: it waits. Any other reason is a fault and stays until an explicit reset, because a
vehicle that has flown blind must not start firing again on its own.

A braking vehicle needs no setpoint of this session, may be fast, and may use its own prediction
for a while, also when it refuses poses; all other conditions apply.

`refuse` checks the flight, `refuse_plan` checks the plan, in the process that owns the port.
"""

from typing import Annotated, NamedTuple

from msgspec import Meta, Struct

from testbed.core.codes import InhibitReason, Refusal
from testbed.core.compiled import compiled
from testbed.core.types import ValveCommand
from testbed.core.vehicle import NonNegative, Positive
from testbed.flight.record import NO_SETPOINT, record

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


class Limits(NamedTuple):
    """Constants of the gate for compiled code; units as in GateParams."""

    pose_timeout: float
    blind: float
    link_timeout: float
    max_rejected: int
    max_speed: float
    max_spin: float
    half_x: float  # of the fence [m]
    half_y: float


def limits_of(params: GateParams, fence: Fence) -> Limits:
    """The constants of a vehicle's gate."""
    return Limits(
        params.pose_timeout_s, max(params.blind_s, params.pose_timeout_s), params.link_timeout_s,
        params.max_rejected, params.max_speed, params.max_spin, fence.half_x, fence.half_y,
    )  # fmt: skip


MEMORY = record(
    fault=int,  # the latched InhibitReason; 0: none
    values=(3,),  # of its words
)


@compiled
def is_number(values):
    """Whether all values of a tuple are finite and their norm is below 1e9."""
    total = 0.0
    for value in values:
        total += value * value
    return total < 1e18  # false for nan and inf


@compiled
def refuse(p, m, row):
    """Reason why the valves must stay shut now; 0: they may open.

    Args:
        p: Limits.
        m: MEMORY, changed in place.
        row: record.ROW.
    """
    inputs, braking = row.inputs, row.outputs.braking == 1
    if m.fault != 0:
        return m.fault
    if inputs.armed == 0:
        return InhibitReason.NOT_ARMED.value
    if inputs.session_ok == 0 and not braking:
        return InhibitReason.OTHER_SESSION.value
    if row.state.known == 0:
        return InhibitReason.NO_POSE_YET.value
    if inputs.setpoint.kind == NO_SETPOINT and not braking:
        return InhibitReason.NO_SETPOINT_YET.value
    m.fault = trouble(p, m.values, row, braking)
    return m.fault


@compiled
def trouble(p, values, row, braking):
    """Reason to latch a fault, its values written to `values`; 0: none."""
    inputs, state, wrench = row.inputs, row.state, row.outputs.commanded
    pose_timeout = p.blind if braking else p.pose_timeout
    if not is_number((state.x, state.y, state.theta, state.vx, state.vy, state.omega)):
        return InhibitReason.ESTIMATE_NOT_FINITE.value
    if not is_number((wrench.fx, wrench.fy, wrench.tau)):
        return InhibitReason.DEMAND_NOT_FINITE.value
    if not -EARLY < state.pose_age <= pose_timeout:
        values[0], values[1] = state.pose_age, pose_timeout
        return InhibitReason.POSE_TOO_OLD.value
    if not braking and state.rejected > p.max_rejected:
        values[0] = state.rejected
        return InhibitReason.POSES_REJECTED.value
    waited = inputs.effect_at - inputs.setpoint.valid_until
    if not braking and not waited <= p.link_timeout:
        values[0], values[1] = waited, p.link_timeout
        return InhibitReason.SETPOINT_TOO_OLD.value
    if abs(state.x) > p.half_x or abs(state.y) > p.half_y:
        values[0], values[1] = state.x, state.y
        return InhibitReason.OUTSIDE_FENCE.value
    speed2 = state.vx * state.vx + state.vy * state.vy
    if not braking and (speed2 > p.max_speed * p.max_speed or abs(state.omega) > p.max_spin):
        values[0], values[1], values[2] = state.vx, state.vy, state.omega
        return InhibitReason.TOO_FAST.value
    if not is_number((inputs.supply_pressure,)):
        return InhibitReason.SUPPLY_NOT_FINITE.value
    return 0


@compiled
def reset(m):
    """Clear the latched reason after the operator's reset."""
    m.fault = 0


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
