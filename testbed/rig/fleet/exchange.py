"""What a vehicle receives before its tick and sends after it, without structs in between."""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sim_twin.board import Wires, play
from sim_twin.camera import Film, Markers, take
from sim_twin.radio import SILENCE, SIZE, Links, send
from testbed.core.bundle import unpacked
from testbed.core.codes import Response
from testbed.core.compiled import compiled
from testbed.core.rows import SETPOINT_WIDTH, References, States, is_finite
from testbed.core.scratch import scratch
from testbed.core.types import ALL_WELL
from testbed.flight.record import NO_SETPOINT
from testbed.flight.reference_model import next_setpoint
from testbed.flight.tick_table import REFERENCES, SAMPLES, STATES, Array, Whole

LAND = Response.LAND.value
FIRST_REFERENCE, REFERENCE_WIDTH, STATE_WIDTH = SETPOINT_WIDTH, References.width, States.width
SENT, DECLINED, NOT_FINITE = range(3)  # see `law_tick`
DISK_FREE = ALL_WELL.disk_free


class Incoming(NamedTuple):
    """The links to a vehicle: rows of `radio.Links`."""

    setpoint: int  # from the host
    states: Whole  # (n,) from the other vehicles
    vehicles: Whole  # (n,) whose they are
    limits: Array  # (n, 2) of the safety filter, see Barrier.neighbour_limits


class VehiclePorts(NamedTuple):
    """What one vehicle reads and writes on the twin."""

    film: Film  # of the cameras
    markers: Markers  # its own, see `camera.take`
    states: Links  # for the vehicles' states
    setpoints: Links
    incoming: Incoming  # links to it
    audience: Whole  # those on which it sends its state
    gauges: Array  # supply and tank pressure [Pa], battery [V]; (3,)
    row: NDArray[Any]  # the chain's record.ROW, (1,)
    others: Array  # neighbours at this tick as in `barrier.around`, (n, 7)
    fixed: NDArray[Any]  # its memory.FIXED, (1,)
    times: Array  # of its plan, memory.Memory.times
    holds: Array  # of its fault table
    wires: Wires  # of its board
    period: float  # of a plan [s]
    lead: float  # until the next pulses take effect [s]
    alert: float  # sigmas of a leak from which bodies nearby are noted


@compiled
def receive(ports, table, k, t, armed):
    """Write the inputs of a tick into row `k` of its table, and into the chain's record.

    Args:
        ports: Bundle of VehiclePorts.
        table: Bundle of the vehicle's TickTable.
        k: row of this tick.
        t: now [s].
        armed: 1: valves may open.

    Returns:
        whether the table has room for all poses and references; otherwise nothing was done.
    """
    ports, table = unpacked(ports), unpacked(table)
    states, setpoints, links, others = ports.states, ports.setpoints, ports.incoming, ports.others
    size = setpoints.tally[links.setpoint, SIZE]
    ahead = (size - FIRST_REFERENCE) // REFERENCE_WIDTH if size > FIRST_REFERENCE else 0
    if ahead > table.references.shape[1]:
        return False
    seen = take(ports.film, ports.markers, table.samples[k])
    if seen < 0:
        return False
    it = ports.row[0].inputs
    it.t, it.effect_at, it.armed, it.ended = t, t + ports.lead, armed, 0
    it.supply_pressure, it.tank_pressure = ports.gauges[0], ports.gauges[1]
    it.battery, it.silent_s = ports.gauges[2], 0.0
    it.session_ok, it.same_config, it.foreign = 1, 1, 0.0
    it.operator_age, it.clock_offset, it.late_s, it.disk_free = 0.0, 0.0, 0.0, DISK_FREE
    it.law_failed, it.fleet_failed = 0, 0
    aim = it.setpoint
    if size == SILENCE:
        aim.kind = NO_SETPOINT
        aim.t = aim.valid_until = aim.fx = aim.fy = aim.theta = aim.omega = aim.alpha = 0.0
    else:
        one = setpoints.newest[links.setpoint]
        aim.kind, aim.t, aim.valid_until, aim.fx, aim.fy = (
            int(one[0]),
            one[1],
            one[2],
            one[3],
            one[4],
        )
        aim.theta, aim.omega, aim.alpha = one[5], one[6], one[7]
        place = FIRST_REFERENCE
        for i in range(ahead):
            for j in range(REFERENCE_WIDTH):
                table.references[k, i, j] = one[place]
                place += 1
    n = 0
    for i in range(links.states.shape[0]):
        link = links.states[i]
        if states.tally[link, SIZE] == SILENCE:
            continue
        one = states.newest[link]
        table.states[k, n] = one[:STATE_WIDTH]
        table.vehicles[k, n] = links.vehicles[i]
        others[n, 0], others[n, 1], others[n, 2], others[n, 3] = one[1], one[2], one[4], one[5]
        others[n, 4], others[n, 5], others[n, 6] = links.limits[i, 0], one[0], links.limits[i, 1]
        n += 1
    counts = table.counts[k]
    counts[SAMPLES], counts[STATES], counts[REFERENCES] = seen, n, ahead
    return True


@compiled
def deliver(ports, table, k):
    """After a tick: play its plan, send its state, and keep its record.

    Args:
        ports: Bundle of VehiclePorts.
        table: Bundle of the vehicle's TickTable.
        k: row of this tick.

    Returns:
        code of the refusal that keeps the valves shut, deciding row of the fault table or -1, code
        that the gate has latched; whether the air goes off; whether something holds or may leak;
        openings of valves by the plan; whether a link has no room for another message.
    """
    ports, table = unpacked(ports), unpacked(table)
    times = ports.times
    it, outputs, now = ports.row[0].state, ports.row[0].outputs, ports.row[0].inputs.t
    table.plans[k], table.holds[k] = times, ports.holds
    table.values[k] = ports.fixed[0].gate.values
    table.records[k] = ports.row[0]
    whole = np.empty(times.shape[0], np.int64)
    for i in range(times.shape[0]):
        whole[i] = int(times[i])
    openings = play(ports.wires, now, now + ports.period, whole)
    full = False
    if it.known == 1:
        state = scratch(STATE_WIDTH)
        state[0], state[1], state[2], state[3] = it.t, it.x, it.y, it.theta
        state[4], state[5], state[6] = it.vx, it.vy, it.omega
        state[7], state[8], state[9] = it.ax, it.ay, it.alpha
        state[10], state[11] = it.pose_age, it.rejected
        full = send(ports.states, ports.audience, now, state)
    lands = outputs.air_off == 1 or outputs.response == LAND
    looks = it.known == 1 and (outputs.leak > ports.alert or outputs.holding > 0)
    return outputs.inhibit, outputs.fault, outputs.gate_fault, lands, looks, openings, full


class HostPorts(NamedTuple):
    """What one law on the host reads and writes on the twin."""

    states: Links  # for the vehicles' states
    own: int  # link from its vehicle
    others: Whole  # links from the others
    vehicles: Whole  # whose these are
    setpoints: Links
    to: Whole  # the link to its vehicle, (1,)
    known: Whole  # the vehicles that its model is made for


@compiled
def attend(ports, table, k):
    """Write the states that the host has received into row `k` of a law's table.

    Args:
        ports: Bundle of HostPorts.
        table: Bundle of a HostTable.
        k: row of this tick.

    Returns:
        number of others; -1: nothing has arrived from the vehicle itself.
    """
    ports, table, n = unpacked(ports), unpacked(table), 0
    states = ports.states
    if states.tally[ports.own, SIZE] == SILENCE:
        return -1
    table.own[k] = states.newest[ports.own, :STATE_WIDTH]
    for i in range(ports.others.shape[0]):
        link = ports.others[i]
        if states.tally[link, SIZE] != SILENCE:
            table.states[k, n] = states.newest[link, :STATE_WIDTH]
            table.vehicles[k, n] = ports.vehicles[i]
            n += 1
    return n


@compiled
def law_tick(ports, table, k, code, model, t, turn, now):
    """A tick of a law in compiled code: receive states, make a setpoint, send it and keep it.

    Args:
        ports: Bundle of HostPorts.
        table: Bundle of a HostTable.
        k: row of this tick.
        code: of the law, like `model`, `t` and `turn` see `next_setpoint`.
        model: Bundle of a ReferenceModel.
        t: time of the model [s].
        turn: at this time.
        now: [s].

    Returns:
        SENT; DECLINED: the vehicles received are not those of the model, or the table has no
        room, and the model was not advanced;
        NOT_FINITE: the setpoint is not finite, and was not sent. Then what `next_setpoint` returns,
        and whether a link has no room for another message.
    """
    n, unchanged = attend(ports, table, k), (0.0, 0.0, -1)
    ports, table, ahead = unpacked(ports), unpacked(table), 1 + unpacked(model).ahead.shape[0]
    known = ports.known
    if n != known.shape[0] or ahead > table.references.shape[1]:
        return DECLINED, unchanged, False
    for i in range(n):
        if table.vehicles[k, i] != known[i]:
            return DECLINED, unchanged, False
    row = scratch(FIRST_REFERENCE + ahead * REFERENCE_WIDTH)
    changed = next_setpoint(code, model, table.states[k, :n], t, turn, row)
    if not is_finite(row):
        return NOT_FINITE, changed, False
    full = send(ports.setpoints, ports.to, now, row)
    table.t[k] = now
    table.setpoints[k] = row[:FIRST_REFERENCE]
    for i in range(ahead):
        for j in range(REFERENCE_WIDTH):
            table.references[k, i, j] = row[FIRST_REFERENCE + i * REFERENCE_WIDTH + j]
    table.counts[k, 0], table.counts[k, 1] = n, ahead
    return SENT, changed, full
