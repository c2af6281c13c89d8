"""One vehicle's flight chain: a pure step from inputs to outputs.

    samples -> estimator -> [guidance, if on board] -> tracker -> fault monitor -> safety filter
            -> allocator -> modulator -> gate -> valve command

No clock, no socket, no file, no randomness. The same inputs in the same order give the same
outputs bit for bit, which is what replay checks.
"""

import numpy as np
from msgspec import Struct, field
from msgspec.structs import replace

from testbed.core.codes import FaultReport, InhibitReason, Refusal
from testbed.core.compiled import compiled, settled
from testbed.core.types import (
    Demand,
    Inputs,
    LawMessage,
    Outputs,
    Reference,
    Setpoint,
    State,
    ValveCommand,
    Wrench,
)
from testbed.core.vehicle import Positive, Vehicle
from testbed.flight.allocation import Allocator, AllocatorParams
from testbed.flight.barrier import BarrierParams
from testbed.flight.ending import EndingParams
from testbed.flight.estimator import Estimator, EstimatorParams
from testbed.flight.gate import Gate, GateParams, closed
from testbed.flight.guidance import Guidance
from testbed.flight.modulation import ModulatorParams, SigmaDeltaParams, make_modulator
from testbed.flight.safety import CALM, Safety
from testbed.flight.tracker import Tracker, TrackerParams, brake, due

STILL = Wrench(0.0, 0.0, 0.0)


class FlightParams(Struct, frozen=True, forbid_unknown_fields=True):
    """Parameters of the chain on board."""

    jet_period_s: Positive = 0.1
    modulator: ModulatorParams = field(default_factory=SigmaDeltaParams)
    estimator: EstimatorParams = field(default_factory=EstimatorParams)
    tracker: TrackerParams = field(default_factory=TrackerParams)
    allocator: AllocatorParams = field(default_factory=AllocatorParams)
    gate: GateParams = field(default_factory=GateParams)
    barrier: BarrierParams = field(default_factory=BarrierParams)
    ending: EndingParams = field(default_factory=EndingParams)


def lead_time(vehicle: Vehicle) -> float:
    """Time from issuing a plan until its pulses produce thrust [s]."""
    return vehicle.command_delay_s + vehicle.valve.open_delay_s


class Agent:
    """One vehicle's flight chain. `guidance` is given if its law runs on board."""

    def __init__(
        self,
        params: FlightParams,
        vehicle: Vehicle,
        estimator: Estimator,
        gate: Gate,
        guidance: Guidance | None = None,
        safety: Safety | None = None,
    ) -> None:
        self._safety = safety
        # a law and the collision filter need the neighbours' states
        self.hears_neighbours = guidance is not None or safety is not None
        self._vehicle, self._period = vehicle, params.jet_period_s
        self._lead = lead_time(vehicle)
        self._estimator, self._gate, self._guidance = estimator, gate, guidance
        self._tracker = Tracker(params.tracker, vehicle)
        self._allocator = Allocator(params.allocator, vehicle)
        self._brake_decel = params.tracker.brake_decel
        self._stop: Reference | None = None
        self._law_error = ""  # exception of the law on board
        self._seq = 0
        valve = vehicle.valve
        # commanded time minus time of flow
        stretch = (valve.open_delay_s - valve.close_delay_s) + 0.5 * (
            valve.open_ramp_s - valve.close_ramp_s
        )
        # the modulator works with times of flow, so it carries over what the board cannot execute
        flow = replace(
            valve,
            min_on_s=max(0.0, valve.min_on_s - stretch),
            min_off_s=max(0.0, valve.min_off_s + 0.5 * stretch),
        )
        self._stretch, in_flow = stretch, replace(vehicle, valve=flow)
        self._in_microseconds = settled(in_microseconds)
        self._modulator = make_modulator(params.modulator, in_flow, params.jet_period_s)

    @property
    def guidance(self) -> Guidance | None:
        """The guidance, if the law runs on board."""
        return self._guidance

    def step(self, inputs: Inputs) -> Outputs:
        """One tick: call it once per jet period, with time increasing."""
        t = inputs.t
        effect_at = t + self._lead
        self._estimator.update(inputs.samples, t)
        state = self._estimator.predict(effect_at, now=t)
        end = inputs.vitals.end
        setpoint, message = None if end else inputs.setpoint, None
        if self._guidance is not None and not end:
            setpoint, message = self._guided(effect_at, state, inputs)
        active_setpoint, commanded_wrench = self._aim(setpoint, state, effect_at)
        thrust_scale = inputs.health.supply_pressure / self._vehicle.air.set_pressure
        acted, braking, done = CALM, False, None
        if self._safety is not None:
            acted = self._safety.act(
                inputs, effect_at, state, setpoint, commanded_wrench, thrust_scale, self._law_error
            )
            commanded_wrench, braking, done = (
                acted.commanded_wrench,
                acted.braking,
                acted.inhibit_reason,
            )
        refused = self._gate.refuse(
            effect_at, inputs.armed, state, setpoint, commanded_wrench, inputs.health,
            session_ok=inputs.vitals.session_ok, braking=braking,
        )  # fmt: skip
        refused = refused or done
        # a vehicle that the gate has shut, or that is disarmed at the end, cannot brake
        air_off = acted.air_off or (inputs.armed and self._gate.fault is not None)
        if end and (not inputs.armed or self._safety is None):
            refused, air_off = refused or Refusal(InhibitReason.FLIGHT_OVER), True
        command, realised_wrench = self._plan(
            t, commanded_wrench if refused is None else STILL, thrust_scale
        )
        if refused is not None:
            command, realised_wrench = closed(command), STILL
        self._estimator.remember(command)
        if self._safety is not None:
            self._safety.remember(command, thrust_scale)
        return Outputs(
            t, state, active_setpoint, commanded_wrench, realised_wrench, command,
            refused, acted.fault or reported(self._gate.fault), message,
            acted.holding, acted.response, acted.filtered, air_off,
        )  # fmt: skip

    def _guided(
        self, t: float, state: State | None, inputs: Inputs
    ) -> tuple[Setpoint | None, LawMessage | None]:
        """The setpoint of the law on board; its model starts when the vehicle is armed."""
        if self._guidance is None or state is None or not inputs.armed or self._law_error:
            return None, None
        try:
            setpoint = self._guidance.step(t, state, inputs.neighbours, inputs.messages)
        except Exception as error:  # after any exception of the law the vehicle flies to a stop
            self._law_error = f"{type(error).__name__}: {error}"
            return None, None
        return setpoint, self._guidance.message

    def _aim(
        self, setpoint: Setpoint | None, state: State | None, t: float
    ) -> tuple[Reference | Demand | None, Wrench]:
        """The setpoint at `t`, and the wrench for it.

        An expired setpoint is not flown: the vehicle comes to rest and waits for the next. The gate
        limits the wait.
        """
        if setpoint is None or state is None:
            return None, STILL
        if t <= setpoint.valid_until:
            self._stop = None
        elif self._stop is None:
            self._stop = brake(state, self._brake_decel)
        if self._stop is not None:
            reference = self._stop
        elif isinstance(setpoint, Demand):
            return setpoint, self._tracker.obey(state, setpoint, self._period)
        else:
            reference = due(setpoint, t)
        return reference, self._tracker.track(state, reference)

    def _plan(
        self, t: float, commanded_wrench: Wrench, thrust_scale: float
    ) -> tuple[ValveCommand, Wrench]:
        """The plan for a wrench, and the mean wrench of the plan by the vehicle file's jet table.

        The mean wrench includes the low supply pressure, which all jets share, but not the droop.
        """
        period, jets = self._period, len(self._vehicle.jets)
        duty = self._allocator.allocate(
            commanded_wrench, max(thrust_scale, 0.1), self._vehicle.air.droop
        )
        on, offset = self._modulator.pulses(duty)
        times, fx, fy, tau = self._in_microseconds(
            on, offset, self._stretch, period, self._allocator.effect
        )
        times_us = times.tolist()
        self._seq += 1
        command = ValveCommand(
            self._seq, t, t + period, tuple(times_us[:jets]), tuple(times_us[jets:])
        )
        return command, Wrench(fx * thrust_scale, fy * thrust_scale, tau * thrust_scale)


def reported(refusal: Refusal | None) -> FaultReport | None:
    """The report of a reason that the gate has latched."""
    return None if refusal is None else FaultReport(refusal.code.name.lower(), refusal.words)


@compiled
def in_microseconds(on, offset, stretch, period, effect):
    """Command times in whole microseconds for the wanted times of flow.

    Args:
        on: shape (jets,) [s].
        offset: shape (jets,) [s].
        stretch: commanded time minus time of flow [s].
        period: longest command [s].
        effect: B, shape (3, jets), see jets.py.

    Returns:
        on, then offsets, shape (2 jets,) [us], and the mean wrench fx, fy, tau of these times.
    """
    jets = on.shape[0]
    times = np.empty(2 * jets, dtype=np.int64)
    fx = fy = tau = 0.0
    for j in range(jets):
        command = on[j]
        if 0.0 < on[j] < period:
            command = min(max(on[j] + stretch, 0.0), period)
        start = min(max(offset[j] - 0.5 * (command - on[j]), 0.0), period - command)
        times[j] = np.rint(1e6 * command)
        times[jets + j] = np.rint(1e6 * start)
        duty = 1e-6 * times[j] / period
        fx += effect[0, j] * duty
        fy += effect[1, j] * duty
        tau += effect[2, j] * duty
    return times, fx, fy, tau
