"""One vehicle's flight chain: compiled functions of (parameters, its memory, the tick's record).

    see:  samples -> estimator
    [law, if on board]
    act:  tracker -> safety filter -> fault monitor -> brake -> gate -> allocator -> modulator
          -> valve times

Call `see` and then `act` once per jet period, with time increasing. They are two entries, so on the
first flight two processes compile them side by side.

No clock, no socket, no file, no randomness. The same inputs in the same order give the same
outputs bit for bit, which is what replay checks.
"""

import math

from testbed.core.bundle import unpacked
from testbed.core.codes import InhibitReason
from testbed.core.compiled import compiled, pasted
from testbed.core.vehicle import LOWEST_SHARE
from testbed.flight import (
    detectors,
    estimator,
    fault_monitor,
    gate,
    innovations,
    online,
    permanent,
    reconfiguration,
    safety,
    tracker,
)
from testbed.flight.allocation import allocate
from testbed.flight.detectors import compare
from testbed.flight.fired import note
from testbed.flight.flow import flow_shares
from testbed.flight.modulation import pulses
from testbed.flight.plan import in_microseconds
from testbed.flight.pose_check import seen_elsewhere


@compiled
def see(vehicle, samples):
    """Write the estimate for the time at which the next pulses take effect.

    Args:
        vehicle: Bundle of Parameters; Memory, changed in place; and an array of one record.ROW,
            whose `inputs` is read and whose `state` is written.
        samples: poses since the last tick, rows (captured at, x, y, theta).
    """
    p, memory, rows = unpacked(vehicle)
    m, row, inputs = memory.fixed[0].estimator, rows[0], rows[0].inputs
    fixed = memory.fixed[0]
    model = online.model_now(p.online, p.model, fixed.gas_used, fixed.thrust_scale)
    estimator.begin_tick(m)
    for k in range(samples.shape[0]):
        sample = samples[k]
        taken = estimator.update(p.filter, model, m, memory.fired, memory.flown, sample, inputs.t)
        if taken and inputs.armed == 1 and not seen_elsewhere(m.step):
            innovations.update(
                p.jets_known.innovations, fixed.jet_faults.innovations, memory.evidence.innovations,
                memory.flown, model, fixed.thrust_scale, sample,
            )  # fmt: skip
    estimator.predict(model, m, memory.fired, inputs.effect_at, inputs.t, row.state)


@compiled
def act(vehicle, samples, references, neighbours):
    """From the estimate and the setpoint to valve times.

    Args:
        vehicle: as for `see`; reads `inputs` and `state` of its record, and writes `outputs`.
        samples: as for `see`.
        references: of a trajectory, see `tracker.aim`.
        neighbours: rows as in `barrier.around`.
    """
    p, memory, rows = unpacked(vehicle)
    row = rows[0]
    m, inputs, state, outputs = memory.fixed[0], row.inputs, row.state, row.outputs
    thrust_scale = inputs.supply_pressure / p.sensors.set_pressure
    gains = online.gains_now(p.online, p.gains, m.gas_used)
    demanded = tracker.aim(gains, m.tracker, state, inputs.setpoint, references, outputs.active)
    outputs.stopping = m.tracker.stopping

    through, spare, outputs.hazard = demanded, math.inf, -1
    if p.filters and state.known == 1:
        through, spare = safety.filtered(
            p.limits, p.obstacles, p.gains.period, row, neighbours, demanded,
            thrust_scale * m.strength,
        )  # fmt: skip
    watch(p, memory, row, samples, neighbours, demanded, spare)
    wrench, shut = safety.respond(
        p.brakes, gains, m.safety, row, demanded, through, thrust_scale * m.strength
    )
    outputs.commanded.fx, outputs.commanded.fy, outputs.commanded.tau = wrench

    refuse(p, m, row, shut)
    plan(p, memory, row, wrench, thrust_scale)


@pasted
def watch(p, memory, row, samples, neighbours, demanded, spare):
    """Detectors and fault monitor: write what they find to `row.outputs`."""
    m, inputs, outputs = memory.fixed[0], row.inputs, row.outputs
    armed = inputs.armed == 1
    if row.state.known == 1 and armed:
        compare(
            p.jets_known, m.jet_faults, memory.evidence, memory.fired,
            m.permanent, memory.permanent, row, m.estimator.step, memory.flowed, m.thrust_scale,
        )  # fmt: skip
        if p.online.each_jet:
            online.follow_jets(memory.fired, memory.evidence, m.jet_faults.probed, p.gains.period)
        reconfiguration.end_probe(
            p.jets_known, m.jet_faults, memory.evidence, memory.fired, memory.named, inputs.t
        )
    finite = gate.is_number(demanded)
    detectors.measure(
        p.sensors, m.detectors, m.estimator, p.jets_known, m.jet_faults, m.permanent, row, samples,
        neighbours, finite, spare,
    )  # fmt: skip
    # a fault after the end gets its response, but is not latched
    latches = armed and inputs.ended == 0
    asks = fault_monitor.look(p.rows, memory.counters, inputs.t, latches, row.numbers, outputs)
    if asks >= 0 and outputs.fault < 0:  # a vehicle that stops anyway keeps what was found
        reconfigure(p, memory, row, asks)
    if outputs.fault >= 0 and reconfiguration.names_a_leak(p.rows.detector[outputs.fault]):
        reconfiguration.take_back(m.jet_faults, memory.fired, memory.named)


@pasted
def reconfigure(p, memory, row, k):
    """Fly on without the jet that row `k` of the fault table names, or with its leak, if possible.

    Two bad jets in a flight mean a wrong vehicle file or wrong wires, and are not flown around. A
    jet may have been left out as weak although another one leaks: when another jet is named, the
    first is used again. If a leak or a weak jet still explain the motion alike, it is the leak, and
    the vehicle flies on if the fault table says so of a valve stuck open.
    """
    m, fired, detector = memory.fixed[0], memory.fired, p.rows.detector[k]
    suspected, named, allowed = m.jet_faults, memory.named, True
    if reconfiguration.needs_no_probe(suspected, detector):
        return
    found = reconfiguration.suspicion_of(suspected, detector)
    if reconfiguration.probes_another(suspected, found.jet):
        reconfiguration.take_back(suspected, fired, named)
        if detector == reconfiguration.DOUBTFUL:
            detector, allowed = reconfiguration.OPEN, reconfiguration.flies_with_a_leak(p.rows)
            found = reconfiguration.suspicion_of(suspected, detector)

    j, guess = found.jet, reconfiguration.is_a_guess(suspected, detector)
    gives, leaks = fired.gives.copy(), fired.leaks.copy()
    reconfiguration.change(fired.gives, fired.leaks, found, detector)
    force, torque = reconfiguration.room(p.jets.effect, fired.gives, fired.leaks)
    alone = reconfiguration.others_at_fault(named, j) == 0
    if not (allowed and alone and reconfiguration.suffices(p.whole, force, torque)):
        fired.gives[:], fired.leaks[:] = gives, leaks
        number = row.numbers[p.rows.detector[k]]
        fault_monitor.refuse(p.rows, memory.counters, k, number, row.outputs)
        return

    m.strength = min(1.0, force / p.whole.force)
    suspected.probed, named[j] = (j + 1 if guess else 0), row.inputs.t
    suspected.flies_open = int(fired.leaks.max() >= reconfiguration.WIDE_OPEN)
    memory.carried.rest[j] = memory.carried.filter[j] = 0.0
    reconfiguration.relearn(p.model, m.estimator, p.jets.effect, j)
    reconfiguration.restart(p.jets_known, suspected, memory.evidence, fired)
    permanent.restart(m.permanent, memory.permanent)


@pasted
def refuse(p, m, row, shut):
    """Ask the gate; `shut` is the reason of the fault table, 0: none."""
    inputs, outputs = row.inputs, row.outputs
    refused = gate.refuse(p.gate, m.gate, row)
    outputs.gate_fault = m.gate.fault
    outputs.inhibit = refused if refused != 0 else shut
    # a vehicle that the gate has shut, or that is disarmed at the end, cannot brake
    if inputs.armed == 1 and m.gate.fault != 0:
        outputs.air_off = 1
    if inputs.ended == 1 and inputs.armed == 0:
        outputs.air_off = 1
        if outputs.inhibit == 0:
            outputs.inhibit = InhibitReason.FLIGHT_OVER.value


@pasted
def plan(p, memory, row, wrench, thrust_scale):
    """The plan for a wrench, or a plan with every valve shut."""
    m, inputs, outputs, period = memory.fixed[0], row.inputs, row.outputs, p.gains.period
    if outputs.inhibit != 0:
        wrench = (0.0, 0.0, 0.0)
    share = thrust_scale if thrust_scale > LOWEST_SHARE else LOWEST_SHARE  # nan, too
    fired, effect = memory.fired, p.jets.effect
    adds = fired.gives - fired.leaks
    fx, fy, tau = wrench
    for j in range(adds.shape[0] if outputs.inhibit == 0 else 0):  # what leaks pushes anyway
        fx -= share * fired.leaks[j] * effect[0, j]
        fy -= share * fired.leaks[j] * effect[1, j]
        tau -= share * fired.leaks[j] * effect[2, j]
    duty = allocate(p.jets, (fx, fy, tau), share * adds)
    on, offset = pulses(p.planner.modulator, memory.carried, duty, adds)
    in_microseconds(p.planner, on, offset, memory.times)
    if outputs.inhibit != 0:
        memory.times[:] = 0.0
    m.seq += 1
    m.thrust_scale, outputs.seq = thrust_scale, m.seq
    starts, ends = inputs.t + p.command_delay, inputs.t + period + p.command_delay
    note(memory.fired, starts, ends, memory.times)
    flow_shares(
        memory.times, memory.begun, memory.after, p.model, fired.gives, fired.leaks, period,
        memory.flowed,
    )  # fmt: skip
    fx = fy = tau = 0.0
    for j in range(adds.shape[0] if outputs.inhibit == 0 else 0):
        given = thrust_scale * memory.flowed[1, j]
        fx += effect[0, j] * given
        fy += effect[1, j] * given
        tau += effect[2, j] * given
    outputs.realised.fx, outputs.realised.fy, outputs.realised.tau = fx, fy, tau
    m.gas_used = online.gas_used(
        p.online, m.gas_used, inputs.tank_pressure, memory.flowed[1], thrust_scale, period
    )


@compiled
def reset(memory):
    """Clear latched faults and the stop that they caused, after the operator's reset."""
    m = memory.fixed[0]
    fault_monitor.reset(memory.counters)
    safety.reset(m.safety)
    gate.reset(m.gate)
