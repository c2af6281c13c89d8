"""Safety on board: the safety filter for every demand, and braking as the fault table says.

It is between tracker and allocator. It cannot open a valve; the gate decides last.
"""

from typing import NamedTuple

from testbed.core.codes import InhibitReason, Response
from testbed.core.compiled import compiled
from testbed.core.se2 import length, to_body_compiled, to_table_compiled
from testbed.core.vehicle import LOWEST_SHARE
from testbed.flight.barrier import guarded
from testbed.flight.record import NO_SETPOINT, record
from testbed.flight.tracker import braking_wrench

AT_REST = 0.003  # below this a vehicle is at rest: the accuracy of the estimate [m/s]
NO_SPIN = 0.02  # [rad/s]
SPARE_S = 0.5  # extra time of an ending after its longest brake [s]


class Brakes(NamedTuple):
    """Constants of braking for compiled code; see ending.EndingParams."""

    decel: float  # of the jets in every direction, at the set pressure [m/s^2]
    longest: float  # [s]
    margin: float
    settle: float  # [s]


MEMORY = record(
    braking=int,  # 1: a stop has begun
    since=float,  # and when [s]
    longest=float,  # time limit of this stop [s]
    stopped=int,  # 1: a stop is over, or was not possible: no second one
)


@compiled
def filtered(limits, obstacles, period, row, neighbours, wrench, thrust_scale):
    """The demand after the safety filter, and the room left after a full stop [m]."""
    state, outputs = row.state, row.outputs
    theta = state.theta + 0.5 * period * state.omega
    fx, fy = to_table_compiled(theta, wrench[0], wrench[1])
    x, y, hazard, spare = guarded(
        row.inputs.effect_at, fx, fy, state.x, state.y, state.vx, state.vy, state.ax, state.ay,
        obstacles, neighbours, limits, max(thrust_scale, LOWEST_SHARE),
    )  # fmt: skip
    outputs.hazard = hazard
    if hazard < 0:
        return wrench, spare
    outputs.dfx, outputs.dfy = x - fx, y - fy
    bx, by = to_body_compiled(theta, x, y)
    return (bx, by, wrench[2]), spare


@compiled
def respond(p, gains, m, row, demanded, through, thrust_scale):
    """The wrench to fly, as the response of the fault table says; 0, or why valves stay shut.

    Args:
        p: Brakes.
        gains: tracker.Gains.
        m: MEMORY, changed in place.
        row: record.ROW.
        demanded: wrench of the tracker.
        through: the same after the safety filter.
        thrust_scale: of the jets' force at the present supply pressure.
    """
    inputs, state, outputs = row.inputs, row.state, row.outputs
    outputs.braking = outputs.air_off = 0
    if inputs.ended == 1:
        outputs.response = max(outputs.response, Response.BRAKE.value)
    if outputs.response <= Response.WARN.value or inputs.armed == 0:
        m.braking = 0  # an unlatched row ended: the next stop starts anew
        return through, 0
    if outputs.response == Response.HOLD.value:
        m.braking = 0
        # the tracker already brakes when setpoints have expired
        setpoint = inputs.setpoint
        flies = setpoint.kind != NO_SETPOINT and inputs.effect_at <= setpoint.valid_until
        if state.known == 0 or not flies:
            return through, 0
        outputs.hazard = -1
        return braking_wrench(gains, state, thrust_scale * p.decel), 0
    outputs.hazard = -1
    brakes = m.stopped == 0 and outputs.response == Response.BRAKE.value and state.known == 1
    decel = max(thrust_scale, LOWEST_SHARE) * p.decel
    if brakes and not is_over(p, m, inputs.t, state, decel):
        outputs.braking = 1
        return braking_wrench(gains, state, thrust_scale * p.decel), 0
    if outputs.fault >= 0 or inputs.ended == 1:
        m.stopped = 1
    # at the end a coasting vehicle lands; a vehicle that has braked needs no more air
    if inputs.ended == 1 or (outputs.response != Response.COAST.value and outputs.fault >= 0):
        outputs.air_off = 1
    if outputs.fault >= 0:
        return demanded, InhibitReason.FAULT.value
    over = inputs.ended == 1
    return demanded, InhibitReason.FLIGHT_OVER.value if over else InhibitReason.RESPONSE.value


@compiled
def reset(m):
    """Forget the stop, so that the next one starts anew."""
    m.braking = m.stopped = 0


@compiled
def is_over(p, m, t, state, decel):
    """Whether a stop has ended: at rest, or too long."""
    speed = length(state.vx, state.vy)
    if m.braking == 0:
        m.braking, m.since = 1, t
        m.longest = longest_brake(p, speed, decel)
    rests = speed <= AT_REST and abs(state.omega) <= NO_SPIN
    return rests or t - m.since > m.longest


@compiled
def longest_brake(p, speed, decel):
    """Time limit of a stop [s].

    Args:
        p: Brakes.
        speed: at its beginning [m/s].
        decel: deceleration that the jets can give in every direction [m/s^2].
    """
    return min(p.longest, p.settle + p.margin * speed / decel)
