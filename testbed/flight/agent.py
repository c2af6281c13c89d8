"""One vehicle on board: the compiled chain with its memory, and structs round it.

The chain knows codes and numbers only. Here the inputs become the tick's record, and the record
becomes the outputs, with the names and words that belong to its codes.
"""

import math
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, cast

import numpy as np
from msgspec.structs import replace

from testbed.core.bundle import Bundle
from testbed.core.codes import Detector, FaultReport, Intervention, Response
from testbed.core.compiled import with_fixed_types
from testbed.core.error import MismatchError
from testbed.core.jets import JetHealth
from testbed.core.rows import PoseSamples, References, numbers_of
from testbed.core.types import (
    Accel,
    Demand,
    Inputs,
    LawMessage,
    Outputs,
    Pose,
    Reference,
    Setpoint,
    State,
    Trajectory,
    Twist,
    ValveCommand,
    Wrench,
)
from testbed.core.vehicle import Vehicle
from testbed.core.warned import Warned
from testbed.flight import chain
from testbed.flight.bad_jet import INNOVATIONS
from testbed.flight.barrier import WIDTH, Barrier
from testbed.flight.effectiveness import MOST
from testbed.flight.estimator import Array
from testbed.flight.fault_warnings import FaultWarnings
from testbed.flight.faults import FaultTable
from testbed.flight.guidance import Guidance, Kept
from testbed.flight.hypotheses import CAUSES, cause_of, leaking, ranked
from testbed.flight.memory import make_memory
from testbed.flight.nearby import Nearby
from testbed.flight.parameters import Parameters
from testbed.flight.permanent import verdict_of
from testbed.flight.record import INPUTS, OUTPUTS, ROW, STATE, packing, places_in
from testbed.flight.refusals import refusal_of, reported
from testbed.flight.silence import blame_link


def lead_time(vehicle: Vehicle) -> float:
    """Time from issuing a plan until its pulses produce thrust [s]."""
    return vehicle.command_delay_s + vehicle.valve.open_delay_s


RESPONSES = tuple(Response)
IN, OUT = packing(INPUTS), packing(STATE, OUTPUTS)
FAULT, HOLDING, OTHER, OLDEST, LEAK, GATE_FAULT = places_in(
    OUTPUTS, "fault", "holding", "other", "oldest", "leak", "gate_fault"
)
STAYS_S = 1.0  # validity of a setpoint to stay, which is renewed at every tick [s]
ALERT = 3.0  # sigmas of a leak from which bodies nearby are noted
NO_FILTER = 0.0, 0.0  # distance to keep, deceleration
NO_REFERENCES = np.zeros((0, 10))


class Agent:
    """One vehicle's flight chain. `guidance` is given if its law runs on board."""

    def __init__(
        self,
        params: Parameters,
        lead: float,
        plans: int,
        faults: FaultTable,
        barrier: Barrier | None,
        nearby: Nearby,
        guidance: Guidance | None = None,
    ) -> None:
        """Fly with these constants.

        Args:
            params: of the chain.
            lead: see `lead_time` [s].
            plans: that the estimator remembers; they must cover the longest pose loss.
            faults: the table that `params.rows` was made from.
            barrier: the same filter as in `params`; None: switched off.
            nearby: what the vehicle may touch, for the words of a fault.
            guidance: of the law on board.
        """
        self.guidance, self._nearby = guidance, nearby
        self.lead, self.barrier = lead, barrier
        self._faults = list(faults.items())
        self._jets = params.jets.gas.shape[0]
        looks, rows = params.jets_known.shown.shape[0], len(faults)
        self.memory, self.everything = make_memory(self._jets, plans, looks, rows)
        self.row = np.zeros(1, ROW)  # of the newest tick
        self._bytes = self.row.view(np.uint8).data
        self.params = params
        self._place: Reference | None = None  # see `staying`
        self._law_error = ""  # exception of the law on board
        self._fault: tuple[int, FaultReport | None] = -1, None  # deciding row, and its report
        self._warnings = FaultWarnings(self._faults)
        self._see, self._act = with_fixed_types(chain.see), with_fixed_types(chain.act)

    @property
    def vehicle(self) -> Bundle:
        """The chain's constants, memory and record at one address, as `chain.see` takes them."""
        return self._vehicle

    @property
    def at_fault(self) -> bool:
        """Whether a row of the fault table has decided something."""
        return self._fault[0] >= 0

    @property
    def params(self) -> Parameters:
        """The chain's constants."""
        return cast(Parameters, self._vehicle.value[0])

    @params.setter
    def params(self, params: Parameters) -> None:
        self._vehicle = Bundle((params, self.memory, self.row))

    def take_over(self, before: "Agent", kept: Kept) -> None:
        """Go on from the memory of another agent of this vehicle.

        Raises:
            MismatchError: the memories differ in size.
        """
        if self.everything.shape != before.everything.shape:
            expected = "parameters with which the vehicle remembers as much as before"
            found = f"{self.everything.size} numbers instead of {before.everything.size}"
            raise MismatchError(expected, found)
        self.everything[:] = before.everything
        self.row[:] = before.row
        for part in ("_law_error", "_fault", "_nearby"):
            setattr(self, part, getattr(before, part))
        self._warnings.found |= before.warned
        if self.guidance is not None and before.guidance is not None:
            self.guidance.take_over(before.guidance, kept)

    def step(self, inputs: Inputs) -> Outputs:
        """One tick: call it once per jet period, with time increasing."""
        setpoint, message = None if inputs.vitals.end else inputs.setpoint, None
        samples, others = PoseSamples.of(inputs.samples).rows, self._others(inputs)
        references = NO_REFERENCES
        # a vehicle that stays after its flight has the setpoint of `staying`
        guidance = self.guidance if setpoint is None else None
        self._write_inputs(inputs, setpoint)
        self._see(self._vehicle, samples)
        if guidance is not None:
            setpoint, message = self._guided(guidance, inputs)
            self._write_inputs(inputs, setpoint)
        if isinstance(setpoint, Trajectory):
            references = References.of(setpoint.references).rows
        self._act(self._vehicle, samples, references, others)
        return self._outputs(inputs, setpoint, message)

    def staying(self, t: float) -> Trajectory | None:
        """The setpoint of a vehicle that comes to rest and stays there; None: no estimate yet."""
        if self._place is None and (state := taken(self._bytes)[0]) is not None:
            pose, twist = state.pose, state.twist
            ahead = math.hypot(twist.vx, twist.vy) / (2.0 * self.params.gains.brake_decel)
            there = Pose(pose.x + ahead * twist.vx, pose.y + ahead * twist.vy, pose.theta)
            self._place = Reference(t, there, Twist(0.0, 0.0, 0.0), Accel(0.0, 0.0, 0.0))
        if self._place is None:
            return None
        return Trajectory((replace(self._place, t=t),), t + STAYS_S)

    @property
    def jets(self) -> tuple[JetHealth, ...]:
        """Each jet as the flight has shown it."""
        memory = self.memory
        gives, leaks, named = memory.fired.gives, memory.fired.leaks, memory.named
        believed = memory.evidence.innovations
        # a jet that is stuck open is judged by what it pushes anyway
        shares = np.maximum(believed.gives, believed.leaks) * (1.0 + memory.evidence.off)
        shares = np.clip(np.where(np.maximum(gives, leaks) > 0.0, shares, 0.0), 0.0, MOST)
        rows = np.column_stack((shares, memory.evidence.sigma, gives, leaks, named)).tolist()
        return tuple(
            JetHealth(share, sigma, gives, leaks, named or None)
            for share, sigma, gives, leaks, named in rows
        )

    @property
    def warned(self) -> dict[str, Warned]:
        """Rows of the fault table that have held without ending the flight."""
        return self._warnings.found

    def _write_inputs(self, inputs: Inputs, setpoint: Setpoint | None) -> None:
        """Write the inputs into the tick's record, in the order of record.INPUTS."""
        health, vitals = inputs.health, inputs.vitals
        IN.pack_into(
            self._bytes, 0, inputs.t, inputs.t + self.lead, inputs.armed, vitals.end,
            health.supply_pressure, health.tank_pressure, health.battery, health.silent_s,
            vitals.session_ok, vitals.operator_age, vitals.clock_offset, vitals.late_s,
            vitals.disk_free, vitals.same_config, vitals.foreign,
            bool(self._law_error or vitals.law_error), vitals.fleet is not None,
            *numbers_of(setpoint),
        )  # fmt: skip

    def _others(self, inputs: Inputs) -> Array:
        """The neighbours as the safety filter and the detectors take them."""
        rows: list[float] = []  # one after the other
        for name, one in inputs.neighbours.items():
            pose, twist = one.pose, one.twist
            keep, hard = NO_FILTER if self.barrier is None else self.barrier.neighbour_limit(name)
            rows += (pose.x, pose.y, twist.vx, twist.vy, keep, one.t, hard)
        return np.array(rows, dtype=np.float64).reshape(-1, WIDTH)

    def _guided(
        self, guidance: Guidance, inputs: Inputs
    ) -> tuple[Setpoint | None, LawMessage | None]:
        """The setpoint of the law on board; its model starts when the vehicle is armed."""
        state, _ = taken(self._bytes)
        if inputs.vitals.end or state is None or not inputs.armed or self._law_error:
            return None, None
        try:
            setpoint = guidance.step(state.t, state, inputs.neighbours, inputs.messages)
        except Exception as error:  # after any exception of the law the vehicle flies to a stop
            self._law_error = f"{type(error).__name__}: {error}"
            return None, None
        return setpoint, guidance.message

    def _outputs(
        self, inputs: Inputs, setpoint: Setpoint | None, message: LawMessage | None
    ) -> Outputs:
        """The tick's record as structs, with names and words for its codes."""
        state, outputs = taken(self._bytes)
        m = self.memory
        if (outputs[LEAK] > ALERT or outputs[HOLDING]) and state is not None:
            self._nearby.look(inputs.t, state, inputs.neighbours)
        self._warn(inputs, outputs)
        report = self.report(outputs[FAULT], outputs[GATE_FAULT], lambda: inputs)
        lists = m.times, m.counters.holds, m.fixed[0].gate.values
        return self.made(state, outputs, inputs, setpoint, report, *lists, message)

    def notice(
        self, fault: int, gate_fault: int, looks: bool, inputs: Callable[[], Inputs]
    ) -> FaultReport | None:
        """What `step` does beside the chain: note what is near, and report the tick's fault.

        Args:
            fault: row of the fault table that decides; -1: none.
            gate_fault: code that the gate has latched; 0: none.
            looks: something holds or may leak.
            inputs: makes the inputs of the tick; they are rarely needed.
        """
        state, outputs = taken(self._bytes) if looks else (None, ())
        if state is not None:
            now = inputs()
            self._nearby.look(now.t, state, now.neighbours)
            self._warn(now, outputs)
        return self.report(fault, gate_fault, inputs)

    def step_row(self, samples: Array, references: Array, neighbours: Array) -> None:
        """One tick of the chain alone; its other inputs are in `row`, see `chain.act`."""
        self._see(self._vehicle, samples)
        self._act(self._vehicle, samples, references, neighbours)

    def report(
        self, fault: int, gate_fault: int, inputs: Callable[[], Inputs]
    ) -> FaultReport | None:
        """The report of row `fault` of the fault table, or of the gate; see `notice`."""
        if fault != self._fault[0]:
            now, outputs = inputs(), taken(self._bytes)[1]
            names = ("", *now.neighbours)
            arguments = now, names[outputs[OTHER] + 1], names[outputs[OLDEST] + 1]
            self._fault = fault, None if fault < 0 else self._report(fault, *arguments)
        found = self._fault[1]
        if found is None and gate_fault:
            values = self.memory.fixed[0].gate.values
            return reported(refusal_of(gate_fault, gate_fault, values))
        return found

    def made(
        self, state: State | None, outputs: Sequence[Any], inputs: Inputs,
        setpoint: Setpoint | None, report: FaultReport | None,
        times: Array, holds: Array, values: Array, message: LawMessage | None,
    ) -> Outputs:  # fmt: skip
        """Outputs from a tick's record and the lists that belong to it.

        Args:
            state: estimate, see `taken`.
            outputs: numbers of record.OUTPUTS.
            inputs: of this tick.
            setpoint: that was flown.
            report: of the tick's fault.
            times: memory.Memory.times.
            holds: fault_monitor.Counters.holds.
            values: of the gate's refusal.
            message: of the law on board.
        """
        (
            seq, stopping, t, x, y, theta, vx, vy, omega, ax, ay, alpha, fx, fy, tau,
            realised_fx, realised_fy, realised_tau, response, _, holding, _, _,
            _, hazard, dfx, dfy, _, inhibit, gate_fault, air_off,
        ) = outputs  # fmt: skip
        active: Reference | Demand | None = None
        if setpoint is not None and state is not None:
            active = setpoint if isinstance(setpoint, Demand) else None
            if stopping or active is None:
                accel = Accel(ax, ay, alpha)
                active = Reference(t, Pose(x, y, theta), Twist(vx, vy, omega), accel)
        filtered = None
        if hazard >= 0 and self.barrier is not None:
            named = self.barrier.hazard(hazard, inputs.neighbours)
            filtered = Intervention(dfx, dfy, *named)
        whole, now = times.astype(np.int64).tolist(), inputs.t
        return Outputs(
            now, state, active, Wrench(fx, fy, tau),
            Wrench(realised_fx, realised_fy, realised_tau),
            ValveCommand(
                seq, now, now + self.params.gains.period,
                tuple(whole[: self._jets]), tuple(whole[self._jets :]),
            ),
            refusal_of(inhibit, gate_fault, values) if inhibit else None, report, message,
            self._holding(holds) if holding else (), RESPONSES[response], filtered, air_off == 1,
        )  # fmt: skip

    def _holding(self, holds: Array) -> tuple[str, ...]:
        """Ids of all rows of the fault table that hold."""
        return tuple(
            name for (name, _), one in zip(self._faults, holds.tolist(), strict=True) if one
        )

    def _warn(self, inputs: Inputs, outputs: Sequence[Any]) -> None:
        """Note the rows of the fault table that hold in flight."""
        if not outputs[HOLDING] or not inputs.armed or inputs.vitals.end:
            return
        names, holds = ("", *inputs.neighbours), self.memory.counters.holds
        other, oldest = names[outputs[OTHER] + 1], names[outputs[OLDEST] + 1]
        detail = partial(self._detail, inputs=inputs, other=other, oldest=oldest)
        self._warnings.look(inputs.t, holds, self.row[0]["numbers"], detail)

    def _report(self, k: int, inputs: Inputs, other: str, oldest: str) -> FaultReport:
        """The report of row `k` of the fault table, which was latched at this tick."""
        name, row = self._faults[k]
        fleet = inputs.vitals.fleet if row.measures == Detector.FLEET else None
        detail = self._detail(row.measures, inputs, other, oldest)
        value = float(self.memory.counters.value[k])
        fault = row.report(name, value, detail, fleet and fleet.origin)
        return blame_link(fault, self._faults, inputs)

    def _detail(self, detector: Detector, inputs: Inputs, other: str, oldest: str) -> str:
        """Text for a detector's number at this tick, if it has one."""
        m, vitals = self.memory.fixed[0].jet_faults, inputs.vitals
        touched = self._nearby.contact(inputs.t)
        touched = touched and f"{touched} or "
        if detector in CAUSES:
            kind = CAUSES[detector]
            found = verdict_of(m, self.memory.fixed[0].permanent, kind)
            by = {Detector.JET_MISSING: m.weak_by, Detector.JET_LEAKS: m.leak_by}
            if by.get(detector) == INNOVATIONS:
                found = m.innovations
            doubtful = detector == Detector.JET_LEAKS_OR_WEAK
            if doubtful and m.innovations.leak.gain > m.leak.gain:  # as innovations_are_surer
                found = m.innovations
            return touched + ranked(found, cause_of(found, kind), self.params.gains.mass)
        step = self.memory.fixed[0].estimator.step
        match detector:
            case Detector.JET_OPEN:
                leak = m.innovations.leak if m.leak_by == INNOVATIONS else m.leak
                return leaking(leak).removeprefix("jet ")
            case Detector.LATE_STEP | Detector.FRAME_STEP | Detector.HEADING_STEP:
                far, turn = math.hypot(step[0], step[1]), math.degrees(step[2])
                return f"{1e3 * far:.0f} mm and {turn:.1f} deg away from one pose to the next"
            case Detector.BUMPED:
                return self._nearby.contact(inputs.t) or "no known body is near"
            case Detector.LAW_ERROR:
                return self._law_error or vitals.law_error
            case Detector.POSE_OF_ANOTHER:
                return other
            case Detector.DISK_FREE:
                return f"{1e-6 * vitals.disk_free:.0f} MB are left"
            case Detector.NEIGHBOUR_AGE:
                return oldest
            case Detector.FLEET:
                return "" if vitals.fleet is None else vitals.fleet.words
        return ""


def taken(record: memoryview) -> tuple[State | None, Sequence[Any]]:
    """The estimate in a tick's record, and the numbers of its record.OUTPUTS."""
    known, t, x, y, theta, vx, vy, omega, ax, ay, alpha, age, rejected, *outputs = OUT.unpack_from(
        record, IN.size
    )
    if not known:
        return None, outputs
    twist, bias = Twist(vx, vy, omega), Accel(ax, ay, alpha)
    return State(t, Pose(x, y, theta), twist, bias, age, rejected), outputs
