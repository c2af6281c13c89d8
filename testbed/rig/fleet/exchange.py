"""What a vehicle hears before its tick and says after it, without structs in between."""

from typing import NamedTuple

import numpy as np

from sim_twin.board import play
from sim_twin.camera import take
from sim_twin.radio import SILENCE, SIZE, send
from testbed.core.codes import Response
from testbed.core.compiled import borrowed, compiled
from testbed.core.rows import SETPOINT_WIDTH, References, States
from testbed.core.types import ALL_WELL, Health
from testbed.flight.record import NO_SETPOINT
from testbed.flight.tick_table import REFERENCES, SAMPLES, STATES, Array, Whole

LAND = Response.LAND.value
FIRST_REFERENCE, REFERENCE_WIDTH, STATE_WIDTH = SETPOINT_WIDTH, References.width, States.width
BATTERY, DISK_FREE = Health(0.0, 0.0, 0.0).battery, ALL_WELL.disk_free


class Hears(NamedTuple):
    """The links that a vehicle listens to: rows of `radio.Links`."""

    setpoint: int  # from the host
    states: Whole  # (n,) from the other vehicles
    vehicles: Whole  # (n,) whose they are
    keep: Array  # (n,) distance that the safety filter keeps from each [m]


@compiled
def hear(film, markers, states, setpoints, hears, gauges, table, k, row, others, t, lead, armed):
    """Write the inputs of a tick into row `k` of its table, and into the chain's record.

    Args:
        film: of the cameras.
        markers: see `camera.take`: those of this vehicle.
        states: links for the vehicles' states.
        setpoints: links for setpoints.
        hears: those that this vehicle hears.
        gauges: supply and tank pressure, shape (2,) [Pa].
        table: of the vehicle.
        k: row of this tick.
        row: the chain's record, an array of one.
        others: written to: neighbours as in `barrier.around`, shape (n, 6).
        t: now [s].
        lead: until the next pulses take effect [s].
        armed: 1: valves may open.

    Returns:
        whether the table has room for all poses and references; otherwise nothing was done.
    """
    states, setpoints, table = borrowed(states), borrowed(setpoints), borrowed(table)
    size = setpoints.tally[hears.setpoint, SIZE]
    ahead = (size - FIRST_REFERENCE) // REFERENCE_WIDTH if size > FIRST_REFERENCE else 0
    if ahead > table.references.shape[1]:
        return False
    seen = take(film, markers, table.samples[k])
    if seen < 0:
        return False
    it = row[0].told
    it.t, it.effect_at, it.armed, it.ended = t, t + lead, armed, 0
    it.supply_pressure, it.tank_pressure = gauges[0], gauges[1]
    it.battery, it.silent_s = BATTERY, 0.0
    it.session_ok, it.same_config, it.foreign = 1, 1, 0.0
    it.operator_age, it.clock_offset, it.late_s, it.disk_free = 0.0, 0.0, 0.0, DISK_FREE
    it.law_failed, it.fleet_failed = 0, 0
    aim = it.setpoint
    if size == SILENCE:
        aim.kind = NO_SETPOINT
        aim.t = aim.valid_until = aim.fx = aim.fy = aim.theta = aim.omega = aim.alpha = 0.0
    else:
        one = setpoints.newest[hears.setpoint]
        aim.kind, aim.t, aim.valid_until, aim.fx, aim.fy = (
            int(one[0]),
            one[1],
            one[2],
            one[3],
            one[4],
        )
        aim.theta, aim.omega, aim.alpha = one[5], one[6], one[7]
        at = FIRST_REFERENCE
        for i in range(ahead):
            for j in range(REFERENCE_WIDTH):
                table.references[k, i, j] = one[at]
                at += 1
    n = 0
    for i in range(hears.states.shape[0]):
        link = hears.states[i]
        if states.tally[link, SIZE] == SILENCE:
            continue
        one = states.newest[link]
        table.states[k, n] = one[:STATE_WIDTH]
        table.vehicles[k, n] = hears.vehicles[i]
        others[n, 0], others[n, 1], others[n, 2], others[n, 3] = one[1], one[2], one[4], one[5]
        others[n, 4], others[n, 5] = hears.keep[i], one[0]
        n += 1
    counts = table.counts[k]
    counts[SAMPLES], counts[STATES], counts[REFERENCES] = seen, n, ahead
    return True


@compiled
def say(fixed, times, holds, wires, states, audience, period, table, k, row, alert):
    """After a tick: play its plan, send its state, and keep its record.

    Args:
        fixed: the vehicle's memory.FIXED.
        times: of its plan, memory.Memory.times.
        holds: of its fault table.
        wires: its board, board.Wires.
        states: links for the vehicles' states.
        audience: those on which it sends.
        period: of a plan [s].
        table: of the vehicle.
        k: row of this tick.
        row: the chain's record, an array of one.
        alert: sigmas of a leak from which bodies nearby are noted.

    Returns:
        code of the refusal that keeps the valves shut, deciding row of the fault table or -1, code
        that the gate has latched; whether the air goes off; whether something holds or may leak;
        openings of valves by the plan; whether a link has no room for another message.
    """
    states, table, wires = borrowed(states), borrowed(table), borrowed(wires)
    it, done, now = row[0].state, row[0].done, row[0].told.t
    table.plans[k], table.holds[k] = times, holds
    table.values[k] = fixed[0].gate.values
    table.records[k] = row[0]
    whole = np.empty(times.shape[0], np.int64)
    for i in range(times.shape[0]):
        whole[i] = int(times[i])
    openings = play(wires, now, now + period, whole)
    full = False
    if it.known == 1:
        state = np.empty(STATE_WIDTH)
        state[0], state[1], state[2], state[3] = it.t, it.x, it.y, it.theta
        state[4], state[5], state[6] = it.vx, it.vy, it.omega
        state[7], state[8], state[9] = it.ax, it.ay, it.alpha
        state[10], state[11] = it.pose_age, it.rejected
        full = send(states, audience, now, state)
    lands = done.air_off == 1 or done.response == LAND
    looks = it.known == 1 and (done.leak > alert or done.holding > 0)
    return done.inhibit, done.fault, done.gate_fault, lands, looks, openings, full


@compiled
def attend(states, own, others, vehicles, table, k):
    """Write what the host has heard of the vehicles into row `k` of a law's table.

    Args:
        states: links for the vehicles' states.
        own: that of the vehicle to the host.
        others: those of the others.
        vehicles: whose these are.
        table: tick_table.HostTable.
        k: row of this tick.

    Returns:
        how many others were heard; -1: the vehicle itself was not.
    """
    states, table, n = borrowed(states), borrowed(table), 0
    if states.tally[own, SIZE] == SILENCE:
        return -1
    table.own[k] = states.newest[own, :STATE_WIDTH]
    for i in range(others.shape[0]):
        link = others[i]
        if states.tally[link, SIZE] != SILENCE:
            table.states[k, n] = states.newest[link, :STATE_WIDTH]
            table.vehicles[k, n] = vehicles[i]
            n += 1
    return n
