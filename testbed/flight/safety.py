"""Safety on board: the watch decides, a braking vehicle is stopped, every demand is filtered.

It sits between tracker and allocator. Nothing here opens a valve: the gate has the last word.
"""

import math
from typing import NamedTuple

import numpy as np

from testbed.core.se2 import to_body, to_table
from testbed.core.types import Inputs, Intervention, Setpoint, State, ValveCommand, Wrench
from testbed.core.vehicle import Vehicle
from testbed.flight.barrier import Barrier
from testbed.flight.detectors import Detectors
from testbed.flight.ending import EndingParams, longest_brake
from testbed.flight.fault_monitor import FaultMonitor
from testbed.flight.faults import SEVERITY
from testbed.flight.flow import Flow
from testbed.flight.tracker import braking_wrench

AT_REST = 0.003  # [m/s] slower is stopped: the estimate is not better
NO_SPIN = 0.02  # [rad/s]
SPARE_S = 0.5  # [s] for an ending, besides its longest brake
WEAKEST_SHARE = 0.1  # of the set pressure: a stop with less would last for ever


class Acted(NamedTuple):
    """What became of a demand."""

    commanded_wrench: Wrench
    response: str = ""
    holding: tuple[str, ...] = ()  # rows of the fault table
    fault: str | None = None  # latched
    filtered: Intervention | None = None
    braking: bool = False
    inhibit_reason: str | None = None
    air_off: bool = False


CALM = Acted(Wrench(0.0, 0.0, 0.0))


class Safety:
    """One vehicle's watch, brake and filter."""

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
        """Guard a vehicle; `decel` [m/s^2] is what its jets can do in every direction."""
        self._ending, self._longest = ending, 0.0
        self._vehicle, self._period, self._decel = vehicle, period, decel
        self._watch, self._detectors, self._barrier = watch, detectors, barrier
        self._flow = Flow(vehicle, period)
        self._duty, self._thrust_scale = np.zeros(len(vehicle.jets)), 1.0
        self._braking_since: float | None = None
        self._stopped: str | None = None

    def act(
        self, inputs: Inputs, effect_at: float, state: State | None, setpoint: Setpoint | None,
        commanded_wrench: Wrench, thrust_scale: float, law_error: str,
    ) -> Acted:  # fmt: skip
        """Judge a tick and say what to do instead of `commanded_wrench`."""
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
        # what is found after the end ends nothing any more: it is answered, not latched
        end = inputs.vitals.end
        latches = inputs.armed and not end
        verdict = self._watch.look(inputs.t, latches, numbers, detectors.said)
        response, holding, fault = verdict
        if end and SEVERITY[response] < SEVERITY["brake"]:
            response = "brake"
        if not response or response == "warn" or not inputs.armed:
            self._braking_since = None  # of a row that is not latched: the next stop is another
            return Acted(through, response, holding, fault, filtered)
        if response == "hold":
            self._braking_since = None
            # the tracker stands already where setpoints ran out: those are not flown
            if state is not None and setpoint is not None and effect_at <= setpoint.valid_until:
                stop = braking_wrench(
                    state, self._vehicle, thrust_scale * self._decel, self._period
                )
                return Acted(stop, response, holding, fault)
            return Acted(through, response, holding, fault, filtered)
        if self._stopped is None and response == "brake" and state is not None:
            stop = braking_wrench(state, self._vehicle, thrust_scale * self._decel, self._period)
            if not self._is_over(inputs.t, state, max(thrust_scale, WEAKEST_SHARE) * self._decel):
                return Acted(stop, response, holding, fault, None, braking=True)
        self._stopped = self._stopped or fault or end or None
        # one that coasts lands when its flight is over; one that has braked needs no air any more
        air_off = bool(end) or (response != "coast" and fault is not None)
        return Acted(
            commanded_wrench, response, holding, fault,
            inhibit_reason=fault or end or response, air_off=air_off,
        )  # fmt: skip

    def remember(self, command: ValveCommand, thrust_scale: float) -> None:
        """Note the plan that was really sent."""
        self._duty, self._thrust_scale = self._flow.of(command), thrust_scale

    @property
    def latched(self) -> tuple[str, ...]:
        """Ids of the latched faults."""
        return self._watch.latched

    def reset(self) -> None:
        """Forget latched faults and the stop that they led to."""
        self._watch.reset()
        self._braking_since, self._stopped = None, None

    def _is_over(self, t: float, state: State, decel: float) -> bool:
        """Whether a stop has come to its end: at rest, or it lasts too long."""
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
        """The demand after the filter; untouched it is the same object."""
        pose, twist, bias = state.pose, state.twist, state.bias
        theta = pose.theta + 0.5 * self._period * twist.omega
        force = to_table(theta, commanded_wrench.fx, commanded_wrench.fy)
        motion = (pose.x, pose.y, twist.vx, twist.vy, bias.ax, bias.ay)
        fx, fy, changed = barrier.filter(t, force, motion, inputs.neighbours, thrust_scale)
        if changed is None:
            return commanded_wrench, None
        return Wrench(*to_body(theta, fx, fy), commanded_wrench.tau), changed
