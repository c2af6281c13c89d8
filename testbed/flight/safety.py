"""Safety on board: fault monitor, braking, and the safety filter for every demand.

It is between tracker and allocator. It cannot open a valve; the gate decides last.
"""

import math
from typing import NamedTuple

import numpy as np

from testbed.core.codes import FaultReport, InhibitReason, Intervention, Refusal, Response
from testbed.core.se2 import to_body, to_table
from testbed.core.types import Inputs, Setpoint, State, ValveCommand, Wrench
from testbed.core.vehicle import Vehicle
from testbed.flight.barrier import Barrier
from testbed.flight.detectors import Detectors
from testbed.flight.ending import EndingParams, longest_brake
from testbed.flight.fault_monitor import FaultMonitor
from testbed.flight.flow import Flow
from testbed.flight.tracker import braking_wrench

AT_REST = 0.003  # below this a vehicle is at rest: the accuracy of the estimate [m/s]
NO_SPIN = 0.02  # [rad/s]
SPARE_S = 0.5  # extra time of an ending after its longest brake [s]
WEAKEST_SHARE = 0.1  # lowest share of the set pressure used for the time of a stop


class Acted(NamedTuple):
    """Result of judging a demand."""

    commanded_wrench: Wrench
    response: Response = Response.NONE
    holding: tuple[str, ...] = ()  # rows of the fault table
    fault: FaultReport | None = None  # latched
    filtered: Intervention | None = None
    braking: bool = False
    inhibit_reason: Refusal | None = None
    air_off: bool = False


CALM = Acted(Wrench(0.0, 0.0, 0.0))


class Safety:
    """One vehicle's fault monitor, brake and safety filter."""

    def __init__(
        self,
        vehicle: Vehicle,
        period: float,
        watch: FaultMonitor,
        detectors: Detectors,
        barrier: Barrier | None,
        decel: float,
        ending: EndingParams = EndingParams(),  # noqa: B008
    ) -> None:
        """Guard a vehicle; `decel` [m/s^2] is the deceleration of its jets in every direction."""
        self._ending, self._longest = ending, 0.0
        self._vehicle, self._period, self._decel = vehicle, period, decel
        self._watch, self._detectors, self._barrier = watch, detectors, barrier
        self._flow = Flow(vehicle, period)
        self._duty, self._thrust_scale = np.zeros(len(vehicle.jets)), 1.0
        self._braking_since: float | None = None
        self._stopped = False

    def act(
        self, inputs: Inputs, effect_at: float, state: State | None, setpoint: Setpoint | None,
        commanded_wrench: Wrench, thrust_scale: float, law_error: str,
    ) -> Acted:  # fmt: skip
        """Judge a tick and return the wrench to use instead of `commanded_wrench`."""
        detectors, barrier = self._detectors, self._barrier
        if state is not None and inputs.armed:
            detectors.compare(inputs, state, self._duty, self._thrust_scale)
        spare, filtered = math.inf, None
        if barrier is not None and state is not None:
            through, filtered = self._filter(
                barrier, effect_at, state, commanded_wrench, inputs, thrust_scale
            )
            spare = barrier.spare
        else:
            through = commanded_wrench
        numbers = detectors.numbers(
            inputs, state, setpoint, commanded_wrench, effect_at, spare, law_error
        )
        # a fault after the end gets its response, but is not latched
        end = inputs.vitals.end
        latches = inputs.armed and not end
        verdict = self._watch.look(inputs.t, latches, numbers, detectors)
        response, holding, fault = verdict
        if end:
            response = max(response, Response.BRAKE)
        if response <= Response.WARN or not inputs.armed:
            self._braking_since = None  # an unlatched row ended: the next stop starts anew
            return Acted(through, response, holding, fault, filtered)
        if response == Response.HOLD:
            self._braking_since = None
            # the tracker already brakes when setpoints have expired
            if state is not None and setpoint is not None and effect_at <= setpoint.valid_until:
                stop = braking_wrench(
                    state, self._vehicle, thrust_scale * self._decel, self._period
                )
                return Acted(stop, response, holding, fault)
            return Acted(through, response, holding, fault, filtered)
        if not self._stopped and response == Response.BRAKE and state is not None:
            stop = braking_wrench(state, self._vehicle, thrust_scale * self._decel, self._period)
            if not self._is_over(inputs.t, state, max(thrust_scale, WEAKEST_SHARE) * self._decel):
                return Acted(stop, response, holding, fault, None, braking=True)
        self._stopped = self._stopped or fault is not None or end
        # at the end a coasting vehicle lands; a vehicle that has braked needs no more air
        air_off = end or (response != Response.COAST and fault is not None)
        why = InhibitReason.FLIGHT_OVER if end else InhibitReason.RESPONSE
        if fault is not None:
            why = InhibitReason.FAULT
        return Acted(
            commanded_wrench, response, holding, fault,
            inhibit_reason=Refusal(why), air_off=air_off,
        )  # fmt: skip

    def remember(self, command: ValveCommand, thrust_scale: float) -> None:
        """Store the plan that was sent."""
        self._duty, self._thrust_scale = self._flow.of(command), thrust_scale

    @property
    def latched(self) -> tuple[str, ...]:
        """Ids of the latched faults."""
        return self._watch.latched

    def reset(self) -> None:
        """Clear latched faults and the stop that they caused."""
        self._watch.reset()
        self._braking_since, self._stopped = None, False

    def _is_over(self, t: float, state: State, decel: float) -> bool:
        """Whether a stop has ended: at rest, or too long."""
        twist = state.twist
        speed = math.hypot(twist.vx, twist.vy)
        if self._braking_since is None:
            self._braking_since = t
            self._longest = longest_brake(self._ending, speed, decel)
        rests = speed <= AT_REST and abs(twist.omega) <= NO_SPIN
        return rests or t - self._braking_since > self._longest

    def _filter(
        self,
        barrier: Barrier,
        t: float,
        state: State,
        commanded_wrench: Wrench,
        inputs: Inputs,
        thrust_scale: float,
    ) -> tuple[Wrench, Intervention | None]:
        """The demand after the filter; the same object if it was not changed."""
        pose, twist, bias = state.pose, state.twist, state.bias
        theta = pose.theta + 0.5 * self._period * twist.omega
        force = to_table(theta, commanded_wrench.fx, commanded_wrench.fy)
        motion = (pose.x, pose.y, twist.vx, twist.vy, bias.ax, bias.ay)
        fx, fy, changed = barrier.filter(t, force, motion, inputs.neighbours, thrust_scale)
        if changed is None:
            return commanded_wrench, None
        return Wrench(*to_body(theta, fx, fy), commanded_wrench.tau), changed
