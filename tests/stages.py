"""The stages of the flight chain one by one: structs in and out, for tests of a single stage."""

from types import SimpleNamespace
from typing import NamedTuple

import numpy as np

from testbed.core.codes import FaultReport, InhibitReason, Refusal, Response
from testbed.core.rows import PoseSamples, References
from testbed.core.types import Accel, Pose, Reference, State, Trajectory, Twist, Wrench
from testbed.flight import (
    allocation,
    bad_jet,
    chain,
    detectors,
    estimator,
    fault_monitor,
    fired,
    flow,
    gate,
    jet_faults,
    modulation,
    safety,
    tracker,
)
from testbed.flight.agent import Agent, lead_time, numbers_of
from testbed.flight.gate import Fence
from testbed.flight.memory import make_memory
from testbed.flight.nearby import Nearby
from testbed.flight.parameters import FlightParams, make_parameters
from testbed.flight.record import REFERENCE, ROW, SETPOINT, STATE


def agent_of(vehicle, table, faults, params=None, fence=None, barrier=None, guidance=None):
    """The chain of a vehicle without an experiment."""
    params, fence = params or FlightParams(), fence or Fence(2.8, 2.8)
    constants = make_parameters(params, vehicle, table, faults, fence, barrier)
    nearby = Nearby(vehicle.radius, table.size, {}, {})
    return Agent(constants, lead_time(vehicle), 48, faults, barrier, nearby, guidance)


def write_state(state, place):
    """A State into a record.STATE."""
    place.known = 0 if state is None else 1
    if state is None:
        return place
    pose, twist, bias = state.pose, state.twist, state.bias
    place.t, place.pose_age, place.rejected = state.t, state.pose_age, state.rejected
    place.x, place.y, place.theta = pose.x, pose.y, pose.theta
    place.vx, place.vy, place.omega = twist.vx, twist.vy, twist.omega
    place.ax, place.ay, place.alpha = bias.ax, bias.ay, bias.alpha
    return place


def as_record(state):
    """A State as a record.STATE."""
    return write_state(state, np.zeros(1, STATE)[0])


def as_setpoint(setpoint):
    """A setpoint as a record.SETPOINT."""
    rows = np.zeros(1, SETPOINT)
    rows[0] = numbers_of(setpoint)
    return rows[0]


def read_state(one):
    """A record.STATE as a State."""
    if not one.known:
        return None
    return State(
        float(one.t), Pose(float(one.x), float(one.y), float(one.theta)),
        Twist(float(one.vx), float(one.vy), float(one.omega)),
        Accel(float(one.ax), float(one.ay), float(one.alpha)),
        float(one.pose_age), int(one.rejected),
    )  # fmt: skip


def read_reference(one):
    """A record.REFERENCE as a Reference."""
    t, x, y, theta, vx, vy, omega, ax, ay, alpha = one.tolist()
    return Reference(t, Pose(x, y, theta), Twist(vx, vy, omega), Accel(ax, ay, alpha))


class Estimator:
    """The stage `estimator`."""

    def __init__(self, params, vehicle, mocap, memory=8):
        self.p, self.model = estimator.filter_of(params, vehicle, mocap), fired.model_of(vehicle)
        self.delay = vehicle.command_delay_s
        everything, _ = make_memory(len(vehicle.jets), memory, 1, 1)
        self.m, self.fired = everything.fixed[0].estimator, everything.fired
        self.flown = everything.flown
        self.out = np.zeros(1, STATE)[0]

    def remember(self, command):
        times = np.array(command.on_us + command.offset_us, dtype=float)
        start, end = command.issued_at + self.delay, command.valid_until + self.delay
        fired.note(self.fired, start, end, times)

    def update(self, samples, now):
        estimator.begin_tick.py_func(self.m)
        for sample in PoseSamples.of(samples).rows:
            estimator.update(self.p, self.model, self.m, self.fired, self.flown, sample, float(now))

    def predict(self, t, now):
        estimator.predict(self.model, self.m, self.fired, float(t), float(now), self.out)
        return read_state(self.out)


class Tracker:
    """The stage `tracker`."""

    def __init__(self, params, vehicle, period=0.1):
        self.p = tracker.gains_of(params, vehicle, period)

    def track(self, state, reference):
        rows = np.zeros(1, REFERENCE)
        rows[0] = tuple(References.of([reference]).rows[0])
        return Wrench(*tracker.track(self.p, as_record(state), rows[0]))

    def obey(self, state, demand, period):
        p = self.p._replace(period=period)
        return Wrench(*tracker.obey(p, as_record(state), as_setpoint(demand)))


def braking_wrench(state, vehicle, decel, period):
    gains = tracker.gains_of(tracker.TrackerParams(), vehicle, period)
    return Wrench(*tracker.braking_wrench(gains, as_record(state), decel))


def carry_forward(reference, t):
    return due(Trajectory((reference,), 0.0), t)


def due(trajectory, t):
    out = np.zeros(1, REFERENCE)
    tracker.due(References.of(trajectory.references).rows, float(t), out[0])
    return read_reference(out[0])


def brake(state, decel):
    out = np.zeros(1, REFERENCE)
    tracker.brake(as_record(state), decel, out[0])
    return read_reference(out[0])


class Allocator:
    """The stage `allocation`."""

    def __init__(self, params, vehicle):
        self.p = allocation.jets_of(params, vehicle)
        self.effect = self.p.effect

    def allocate(self, wanted, thrust_scale=1.0):
        wrench = (float(wanted.fx), float(wanted.fy), float(wanted.tau))
        share = np.full(len(self.p.gas), float(thrust_scale))
        return allocation.allocate(self.p, wrench, share)


class Modulator:
    """The stage `modulation`."""

    def __init__(self, params, vehicle, period):
        self.p = modulation.modulator_of(params, vehicle, period)
        self.carried = modulation.Carried(*np.zeros((3, len(vehicle.jets))))

    def pulses(self, duty):
        duty = np.ascontiguousarray(duty, dtype=float)
        return modulation.pulses(self.p, self.carried, duty, np.ones_like(duty))


class Flow:
    """The stage `flow`."""

    def __init__(self, vehicle, period):
        (self.begun, self.after), self.period = np.zeros((2, len(vehicle.jets))), period
        self.model = fired.model_of(vehicle)

    def of(self, command):
        """Without and with droop, (2, jets)."""
        times, share = np.array(command.on_us + command.offset_us, float), np.zeros((2, 8))
        whole, none = np.ones(8), np.zeros(8)
        flow.flow_shares(times, self.begun, self.after, self.model, whole, none, self.period, share)
        return share


class Suspicion(NamedTuple):
    """The best suspicion of its kind."""

    jet: int
    size: float
    gain: float
    sigmas: float


class JetFaultDetector:
    """The stage `jet_faults`."""

    def __init__(self, vehicle, period, params, table):
        self.p = jet_faults.known_of(vehicle, period, params, table)
        everything, _ = make_memory(len(vehicle.jets), 1, len(self.p.shown), 1)
        self.m, self.evidence = everything.fixed[0].jet_faults, everything.evidence

    def look(self, state, duty, thrust_scale):
        """The jets do not weaken each other."""
        row, duties = as_record(state), np.array((duty, duty))
        jet_faults.look(self.p, self.m, self.evidence, row, duties, thrust_scale)

    def pause(self):
        jet_faults.pause(self.p, self.m, self.evidence)

    @property
    def open(self):
        return self._if(bad_jet.leaks, self.m.leak, self.p.least)

    @property
    def weak(self):
        return self._if(bad_jet.is_weak, self.m.weak)

    @property
    def weak_by_innovations(self):
        fine = self.m.innovations.weak
        return bad_jet.is_weak_by_innovations(self.m), int(fine.jet), float(fine.share)

    @property
    def either(self):
        doubt = bad_jet.leaks_or_is_weak
        least = self.p.least
        return self._if(doubt, self.m.leak, least), self._if(doubt, self.m.weak, least)

    def _if(self, sure, one, *least):
        if not sure(self.m, *least):
            return Suspicion(0, 0.0, 0.0, 0.0)
        return Suspicion(
            int(one.jet), float(one.share), float(one.gain), float(bad_jet.sigmas(one))
        )


class Detectors:
    """Single detectors of the stage `detectors`."""

    def __init__(self, before=None):
        self.m = np.zeros(1, detectors.MEMORY)[0]
        if before is not None:
            pose, twist = before.pose, before.twist
            self.m.known, self.m.before[:] = 1, (before.t, pose.x, pose.y, twist.vx, twist.vy)

    def count_repeats(self, samples):
        return detectors.count_repeats(self.m, PoseSamples.of(samples).rows)

    def jump(self, samples, clock_offset=0.0):
        return detectors.jump(self.m, PoseSamples.of(samples).rows, clock_offset)

    @staticmethod
    def whose(jumped, samples, others):
        rows = [(o.pose.x, o.pose.y, o.twist.vx, o.twist.vy, 0.0, o.t) for o in others.values()]
        k = detectors.whose(jumped, PoseSamples.of(samples).rows, np.array(rows))
        return list(others)[k] if k >= 0 else None


class Gate:
    """The stage `gate`."""

    def __init__(self, params, fence):
        self.p, self.m = gate.limits_of(params, fence), np.zeros(1, gate.MEMORY)[0]

    def refuse(self, t, armed, state, setpoint, wrench, health, *, session_ok=True, braking=False):
        row = np.zeros(1, ROW)[0]
        row.inputs.effect_at, row.inputs.armed, row.inputs.session_ok = t, armed, session_ok
        row.inputs.supply_pressure = health.supply_pressure
        row.inputs.setpoint = as_setpoint(setpoint)
        write_state(state, row.state)
        row.outputs.braking = braking
        done = row.outputs.commanded
        done.fx, done.fy, done.tau = wrench.fx, wrench.fy, wrench.tau
        return self._read(gate.refuse(self.p, self.m, row))

    def _read(self, code):
        if code == 0:
            return None
        reason = InhibitReason(code)
        return Refusal(reason, tuple(self.m.values[: reason.words.count("{")].tolist()))

    @property
    def fault(self):
        return self._read(self.m.fault)

    def reset(self):
        gate.reset(self.m)


class Verdict(NamedTuple):
    """Result of a tick of the fault monitor: names, not rows."""

    response: Response
    holding: tuple
    fault: FaultReport | None


QUIET = Verdict(Response.NONE, (), None)


class FaultMonitor:
    """The stage `fault_monitor`."""

    def __init__(self, table):
        self.table, self.names, self.p = table, list(table), fault_monitor.rows_of(table)
        self.counters, self.row = make_memory(1, 1, 1, len(table))[0].counters, np.zeros(1, ROW)[0]
        self.reports = {}

    def look(self, t, armed, numbers, said=""):
        done = self.row.outputs
        numbers = np.array(numbers, float)
        asks = fault_monitor.look(self.p, self.counters, float(t), armed, numbers, done)
        if asks >= 0:  # the jets left do not suffice
            number = float(numbers[self.p.detector[asks]])
            fault_monitor.refuse(self.p, self.counters, asks, number, done)
        holds = tuple(n for n, k in zip(self.names, self.counters.holds, strict=True) if k)
        for name in self.latched:
            value = self.counters.value[self.names.index(name)]
            self.reports.setdefault(name, self.table[name].report(name, value, said, None))
        fault = None if done.fault < 0 else self.reports[self.names[done.fault]]
        return Verdict(Response(done.response), holds, fault)

    @property
    def latched(self):
        order = self.counters.latched
        return tuple(self.names[k] for k in np.argsort(order, kind="stable") if order[k])

    def reset(self):
        fault_monitor.reset(self.counters)
        self.reports.clear()


class Safety:
    """The stages `detectors`, `fault_monitor` and `safety` together, without the safety filter."""

    def __init__(self, vehicle, table, faults, decel=None, ending=None):
        params = FlightParams() if ending is None else FlightParams(ending=ending)
        self.agent = agent_of(vehicle, table, faults, params)
        self.p = self.agent.params
        if decel is not None:
            self.p = self.p._replace(brakes=self.p.brakes._replace(decel=decel))

    def act(self, inputs, effect_at, state, setpoint, wrench, thrust_scale, law_error=""):
        agent, memory, row = self.agent, self.agent.memory, self.agent.row[0]
        agent._law_error = law_error
        agent._write_inputs(inputs, setpoint)
        row.inputs.effect_at = effect_at
        write_state(state, row.state)
        demanded = (wrench.fx, wrench.fy, wrench.tau)
        row.outputs.hazard = -1
        others, samples = agent._others(inputs), PoseSamples.of(inputs.samples).rows
        chain.watch(self.p, memory, row, samples, others, demanded, np.inf)
        flown, shut = safety.respond(
            self.p.brakes, self.p.gains, memory.fixed[0].safety, row, demanded, demanded,
            float(thrust_scale),
        )  # fmt: skip
        done = row.outputs
        report = agent._report(int(done.fault), inputs, "", "") if done.fault >= 0 else None
        return SimpleNamespace(
            commanded_wrench=Wrench(*flown), response=Response(done.response),
            holding=agent._holding(agent.memory.counters.holds), fault=report,
            braking=bool(done.braking),
            inhibit_reason=Refusal(InhibitReason(shut)) if shut else None,
            air_off=bool(done.air_off),
        )  # fmt: skip

    @property
    def latched(self):
        order = self.agent.memory.counters.latched
        names = [name for name, _ in self.agent._faults]
        return tuple(names[k] for k in np.argsort(order, kind="stable") if order[k])

    def reset(self):
        chain.reset(self.agent.memory)


def longest_brake(params, speed, decel):
    """`safety.longest_brake` with the ending of an experiment."""
    brakes = safety.Brakes(decel, params.brake_s, params.margin, params.settle_s)
    return safety.longest_brake(brakes, float(speed), float(decel))
