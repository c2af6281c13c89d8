"""One vehicle's flight chain: a pure step from what it is told to what it does.

    samples -> estimator -> [guidance, if the law runs here] -> tracker -> allocator -> modulator
            -> gate -> valve command

No clock, no socket, no file, no randomness. The same inputs in the same order give the same
outputs bit for bit, which is what replay checks.
"""

import numpy as np
from msgspec import Struct, field
from msgspec.structs import replace
from numpy.typing import NDArray

from testbed.core.types import (
    Demand,
    Inputs,
    Outputs,
    Reference,
    Setpoint,
    State,
    ValveCommand,
    Wrench,
)
from testbed.core.vehicle import Positive, Vehicle
from testbed.flight.allocation import Allocator, AllocatorParams
from testbed.flight.estimator import Estimator, EstimatorParams
from testbed.flight.gate import Gate, GateParams, closed
from testbed.flight.guidance import Guidance
from testbed.flight.modulation import ModulatorParams, SigmaDeltaParams, make_modulator
from testbed.flight.tracker import Tracker, TrackerParams, brake, due

Array = NDArray[np.float64]

STILL = Wrench(0.0, 0.0, 0.0)


class FlightParams(Struct, frozen=True, forbid_unknown_fields=True):
    """The chain on board."""

    jet_period_s: Positive = 0.1
    modulator: ModulatorParams = field(default_factory=SigmaDeltaParams)
    estimator: EstimatorParams = field(default_factory=EstimatorParams)
    tracker: TrackerParams = field(default_factory=TrackerParams)
    allocator: AllocatorParams = field(default_factory=AllocatorParams)
    gate: GateParams = field(default_factory=GateParams)


def lead_time(vehicle: Vehicle) -> float:
    """From issuing a plan until its pulses begin to push [s]."""
    return vehicle.command_delay_s + vehicle.valve.open_delay_s


class Agent:
    """One vehicle. `guidance` is given when its law runs on board."""

    def __init__(
        self,
        params: FlightParams,
        vehicle: Vehicle,
        estimator: Estimator,
        gate: Gate,
        guidance: Guidance | None = None,
    ) -> None:
        self._vehicle, self._period = vehicle, params.jet_period_s
        self._lead = lead_time(vehicle)
        self._estimator, self._gate, self._guidance = estimator, gate, guidance
        self._tracker = Tracker(params.tracker, vehicle)
        self._allocator = Allocator(params.allocator, vehicle)
        self._brake_decel = params.tracker.brake_decel
        self._stop: Reference | None = None
        self._seq = 0
        valve = vehicle.valve
        # how much longer than the flow the commanded time must be
        stretch = (valve.open_delay_s - valve.close_delay_s) + 0.5 * (
            valve.open_ramp_s - valve.close_ramp_s
        )
        # the modulator thinks in times of flow, so that it carries over what the board cannot play
        flow = replace(
            valve,
            min_on_s=max(0.0, valve.min_on_s - stretch),
            min_off_s=max(0.0, valve.min_off_s + 0.5 * stretch),
        )
        self._stretch, in_flow = stretch, replace(vehicle, valve=flow)
        self._modulator = make_modulator(params.modulator, in_flow, params.jet_period_s)

    @property
    def guidance(self) -> Guidance | None:
        """The law at work, if it runs on board."""
        return self._guidance

    @property
    def hears_neighbours(self) -> bool:
        """Whether neighbours' states are of any use to it: its law runs on board."""
        return self._guidance is not None

    def step(self, inputs: Inputs) -> Outputs:
        """One tick: call it once per jet period, with time increasing."""
        t = inputs.t
        effect_at = t + self._lead
        self._estimator.update(inputs.samples, t)
        state = self._estimator.predict(effect_at, now=t)
        setpoint, told = inputs.setpoint, None
        if self._guidance is not None and state is not None:
            setpoint = self._guidance.step(effect_at, state, inputs.neighbours, inputs.told)
            told = self._guidance.told
        flown, wanted = self._aim(setpoint, state, effect_at)
        refused = self._gate.refuse(effect_at, inputs.armed, state, setpoint, wanted, inputs.health)
        share = inputs.health.supply_pressure / self._vehicle.air.set_pressure
        command = self._plan(t, wanted if refused is None else STILL, share)
        if refused is not None:
            command = closed(command)
        self._estimator.remember(command)
        return Outputs(
            t, state, flown, wanted, self._given(command, share), command,
            refused, self._gate.fault, told,
        )  # fmt: skip

    def _aim(
        self, setpoint: Setpoint | None, state: State | None, t: float
    ) -> tuple[Reference | Demand | None, Wrench]:
        """What to fly at `t`, and the wrench that flies it.

        A setpoint that has run out is not flown: the vehicle comes to rest and waits for the next.
        How long it may wait is the gate's to say.
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

    def _plan(self, t: float, wanted: Wrench, share: float) -> ValveCommand:
        duty = self._allocator.allocate(wanted, max(share, 0.1))
        jets_on = np.count_nonzero(duty)
        if jets_on > 1:
            duty = np.minimum(1.0, duty * (1.0 + self._vehicle.air.droop * (jets_on - 1)))
        on, offset = self._modulator.pulses(duty)
        if self._stretch != 0.0:
            on, offset = self._stretched(on, offset)
        self._seq += 1
        return ValveCommand(
            self._seq,
            t,
            t + self._period,
            tuple(np.rint(1e6 * on).astype(int).tolist()),
            tuple(np.rint(1e6 * offset).astype(int).tolist()),
        )

    def _stretched(self, on: Array, offset: Array) -> tuple[Array, Array]:
        """Command times that give the wanted flow times."""
        partial = (on > 0.0) & (on < self._period)
        command = np.where(partial, np.clip(on + self._stretch, 0.0, self._period), on)
        return command, np.clip(offset - 0.5 * (command - on), 0.0, self._period - command)

    def _given(self, command: ValveCommand, share: float) -> Wrench:
        """Mean wrench of a plan, without droop, by the vehicle file's table."""
        full = self._allocator.wrench([1e-6 * on / self._period for on in command.on_us])
        return Wrench(full.fx * share, full.fy * share, full.tau * share)
