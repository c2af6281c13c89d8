"""Many ticks of the twin in one compiled call, while nothing out of the ordinary happens.

The order is that of `loop.fly`: the twin comes to the tick, every vehicle takes its step, then
every law. All of it is the same compiled code that Python calls when it flies tick by tick.
"""

from typing import NamedTuple

from sim_twin.board import Pulses
from testbed.core.bundle import Bundle, unpacked
from testbed.core.code_address import CodeAddress, call, same_kind
from testbed.core.compiled import compiled, pasted
from testbed.flight.tick_table import REFERENCES, SAMPLES, STATES, Array, Whole
from testbed.rig.fleet.exchange import DECLINED, SENT

PORTS, TABLE, CHAIN, MODEL = 0, 1, 2, 2  # columns of `FleetPorts.vehicles` and `FleetPorts.laws`
# places in `SpanBuffers.progress`, see `fly_ticks`
TICKS, VEHICLES, LAWS, FRAME, FRAMES, TOUCHES, MOST, PROGRESS = range(8)
INHIBIT, FAULT, GATE_FAULT, LANDS, LOOKS, FULL = range(6)  # of a tick, see exchange.deliver
STATUS, DFX, DFY, HAZARD, FILLED = range(5)  # of a law's tick, see exchange.law_tick


class Codes(NamedTuple):
    """Machine code of what a tick calls."""

    exposures: CodeAddress
    advance: CodeAddress
    observe: CodeAddress
    receive: CodeAddress
    see: CodeAddress
    act: CodeAddress
    deliver: CodeAddress
    law_tick: CodeAddress
    law: CodeAddress  # see reference_model.code_for


class TwinPorts(NamedTuple):
    """What a tick reads and writes on the twin."""

    rate: float  # of the cameras [Hz]
    phase: float  # of their first frame, in frames
    plant: Bundle  # of plant.PlantArrays
    pulses: Pulses  # of the plant
    sensors: Bundle  # of twin.SensorPorts
    shown: Whole  # see camera.photograph
    room: int  # of the film, for poses of a body
    x: Array  # true states, (v, 6)


class FleetPorts(NamedTuple):
    """All vehicles, their laws on the host, and the twin that they fly on."""

    codes: Codes
    twin: Bundle  # of TwinPorts
    period: float  # of a tick [s]
    silent_s: float  # see loop.host_fault [s]
    ports: Bundle  # of the first vehicle, for its kind: exchange.VehiclePorts
    table: Bundle  # TickTable
    chain: Bundle  # see chain.see
    law_ports: Bundle  # of the first law: exchange.HostPorts
    law_table: Bundle  # HostTable
    model: Bundle  # ReferenceModel
    vehicles: Whole  # addresses of each vehicle's bundles: PORTS, TABLE, CHAIN
    laws: Whole  # of each law's: PORTS, TABLE, MODEL


class SpanBuffers(NamedTuple):
    """What many ticks have brought, beside the rows of the tables; written to."""

    progress: Whole  # (PROGRESS,)
    now: Array  # time of the twin [s], (1,)
    rows: Whole  # (v,) next row of each vehicle's table
    law_rows: Whole  # (v,) next row of each law's table
    times: Array  # of the cameras' exposures [s]
    seen: Array  # true states at these times, (n, v, 6)
    truth: Array  # true states at the ticks, (n, v, 6)
    flags: Array  # of each vehicle's newest tick, (v, 6)
    openings: Whole  # of valves, (v,)
    model_t: Array  # time of each law's model [s], (v,)
    turns: Array  # of each law's model at each tick, (n, v, 3)
    answers: Array  # of each law at each tick, (n, v, 5)


@compiled
def fly_ticks(fleet, flown, first, count):
    """Fly ticks, and stop after the first step that asks for Python, or before it.

    Args:
        fleet: Bundle of FleetPorts.
        flown: Bundle of SpanBuffers. At the end `progress` says how many TICKS are complete, and
            how many VEHICLES and LAWS have taken their step of the next one. FRAME is the number
            of the cameras' next frame, FRAMES how many they have taken, TOUCHES the rows of the
            plant's touches, MOST as Cameras.most.
        first: number of the first tick.
        count: of ticks, at most.
    """
    it, out = unpacked(fleet), unpacked(flown)
    progress = out.progress
    for k in range(count):
        now = (first + k) * it.period
        if not advance_twin(it, out, now):
            return
        out.truth[k] = unpacked(it.twin).x
        for v in range(it.vehicles.shape[0]):
            if not step_vehicle(it, out, v, now):
                return
        for v in range(it.laws.shape[0]):
            if not step_law(it, out, k, v, now):
                return
        progress[TICKS] += 1
        progress[VEHICLES] = progress[LAWS] = 0
        if progress[TOUCHES] > 0:
            return


@pasted
def advance_twin(it, out, now):
    """Let the twin come to `now`; whether there is room for what its cameras will see."""
    twin, codes, progress = unpacked(it.twin), it.codes, out.progress
    frame, begin = progress[FRAME], progress[FRAMES]
    free = out.times[begin:]
    frames = call(codes.exposures, (twin.rate, twin.phase, frame, now, free))
    if frames > free.shape[0] or progress[MOST] + frames > twin.room:
        return False
    times, seen = free[:frames], out.seen[begin : begin + frames]
    origin = round(out.now[0] * 1e9)
    span = 1e-9 * (round(now * 1e9) - origin)
    progress[TOUCHES] = call(codes.advance, (twin.plant, twin.pulses, origin, span, times, seen))
    progress[MOST] = call(codes.observe, (twin.sensors, times, seen, twin.shown, now))
    progress[FRAME], progress[FRAMES], out.now[0] = frame + frames, begin + frames, now
    return True


@pasted
def step_vehicle(it, out, v, now):
    """A step of a vehicle; whether it asks for nothing."""
    codes, own, row, flags = it.codes, it.vehicles[v], out.rows[v], out.flags[v]
    ports, chain = same_kind(it.ports, own[PORTS]), same_kind(it.chain, own[CHAIN])
    table = same_kind(it.table, own[TABLE])
    if not call(codes.receive, (ports, table, row, now, 1)):
        return False
    ticks, others = unpacked(table), unpacked(ports).others
    counts = ticks.counts[row]
    samples = ticks.samples[row, : counts[SAMPLES]]
    references = ticks.references[row, : counts[REFERENCES]]
    call(codes.see, (chain, samples))
    call(codes.act, (chain, samples, references, others[: counts[STATES]]))
    asked = call(codes.deliver, (ports, table, row))
    inhibit, fault, gate_fault, lands, looks, openings, full = asked
    flags[INHIBIT], flags[FAULT], flags[GATE_FAULT] = inhibit, fault, gate_fault
    flags[LANDS], flags[LOOKS], flags[FULL] = lands, looks, full
    out.openings[v] += openings
    out.rows[v] += 1
    out.progress[VEHICLES] += 1
    return inhibit == 0 and fault < 0 and gate_fault == 0 and not (lands or looks or full)


@pasted
def step_law(it, out, k, v, now):
    """A step of a law; whether it asks for nothing."""
    own, row, answer, turn = it.laws[v], out.law_rows[v], out.answers[k, v], out.turns[k, v]
    ports, model = same_kind(it.law_ports, own[PORTS]), same_kind(it.model, own[MODEL])
    table = same_kind(it.law_table, own[TABLE])
    status, changed, full = call(
        it.codes.law_tick,
        (ports, table, row, it.codes.law, model, out.model_t[v], (turn[0], turn[1], turn[2]), now),
    )
    if status == DECLINED:
        return False
    answer[STATUS], answer[FILLED] = status, full
    answer[DFX], answer[DFY], answer[HAZARD] = changed[0], changed[1], changed[2]
    out.model_t[v] += it.period
    out.progress[LAWS] += 1
    if status != SENT:
        return False
    out.law_rows[v] += 1
    return not full and now - unpacked(table).own[row, 0] <= it.silent_s
