"""The detectors of the fault table: each gives a number that measures a deviation.

Each detector gets its data as arguments; only those that compare with earlier ticks have a memory.
`Detectors.numbers` returns all numbers in the order of `codes.Detector`.
"""

import math
from collections.abc import Mapping, Sequence

from testbed.core.codes import Detector, FaultReport
from testbed.core.types import Inputs, PoseSample, Setpoint, State, Trajectory, Wrench
from testbed.core.vehicle import Vehicle
from testbed.flight.gate import is_number
from testbed.flight.jet_faults import Array, JetFaultDetector
from testbed.flight.nearby import Nearby, place

SAME_PLACE = 0.15  # a pose this near to another vehicle's prediction belongs to it [m]
TRUSTED_AGE = 0.1  # largest age of a pose for evidence about valves [s]
TRUSTED = 8  # most refused poses for evidence about valves
SAME_CLOCK = 0.005  # largest clock offset for evidence about valves [s]
ALERT = 3.0  # sigmas of a leak from which bodies nearby are noted
FAR = 0.05  # a pose this far from the own prediction is not the own one [m]


class Repeats:
    """Counts identical poses from the cameras."""

    def __init__(self) -> None:
        self._last: PoseSample | None = None
        self._count = 0

    def count(self, samples: Sequence[PoseSample]) -> int:
        """Identical poses in a row after these samples; 0: the newest one differs."""
        last, count = self._last, self._count
        for s in samples:
            same = last is not None and s.x == last.x and s.y == last.y and s.theta == last.theta
            last, count = s, count + 1 if same else 0
        self._last, self._count = last, count
        return count


def jump(before: State | None, samples: Sequence[PoseSample]) -> float:
    """Distance of the newest pose from the prediction of the last estimate [m]."""
    if before is None or not samples:
        return 0.0
    newest = samples[-1]
    x, y = place(before, newest.captured_at)
    return math.hypot(newest.x - x, newest.y - y)


def whose(
    jumped: float, samples: Sequence[PoseSample], neighbours: Mapping[str, State]
) -> str | None:
    """The other vehicle whose prediction matches the newest pose; empty: none."""
    if jumped <= FAR or not samples:
        return None
    newest = samples[-1]
    for name, state in neighbours.items():
        x, y = place(state, newest.captured_at)
        if math.hypot(newest.x - x, newest.y - y) < min(SAME_PLACE, jumped):
            return name
    return None


def due_at(setpoint: Setpoint) -> float:
    """The time from which a setpoint is meant to be flown [s]."""
    return setpoint.references[0].t if isinstance(setpoint, Trajectory) else setpoint.t


class Detectors:
    """All detectors of one vehicle."""

    def __init__(
        self, vehicle: Vehicle, evidence: JetFaultDetector, nearby: Nearby, *, noisy: bool
    ) -> None:
        """`noisy` cameras never repeat a pose exactly; others may, for a vehicle at rest."""
        self._set_pressure, self._full = vehicle.air.set_pressure, vehicle.air.tank_pressure
        self._tank: tuple[float, float] | None = None  # time [s] and pressure [Pa] at the last tick
        self._repeats = Repeats() if noisy else None
        self._evidence, self._nearby = evidence, nearby
        self._before: State | None = None
        self._law_error, self._other, self._oldest = "", "", ""  # see `said`
        self._t = 0.0  # of this tick [s]
        self.fleet: FaultReport | None = None  # fault of another vehicle, at this tick

    def compare(self, inputs: Inputs, state: State, duty: Array, thrust_scale: float) -> None:
        """Compare the motion with the flow of the last plan; see `JetFaultDetector.look`.

        Poses that are old, refused or of another clock are no evidence about valves.
        """
        ours = abs(inputs.vitals.clock_offset) < SAME_CLOCK
        if state.pose_age < TRUSTED_AGE and state.rejected <= TRUSTED and ours:
            self._evidence.look(state, duty, thrust_scale)
        else:
            self._evidence.pause()

    def numbers(
        self, inputs: Inputs, state: State | None, setpoint: Setpoint | None,
        commanded_wrench: Wrench, effect_at: float, spare: float, law_error: str,
    ) -> tuple[float, ...]:  # fmt: skip
        """The detectors' numbers at this tick.

        Args:
            inputs: of this tick.
            state: estimate for `effect_at`.
            setpoint: to be flown.
            wanted: wrench of law or tracker.
            effect_at: when the next plan begins to act [s].
            spare: room left after a full stop [m].
            raised: exception of the law.
        """
        vitals, health, samples = inputs.vitals, inputs.health, inputs.samples
        law_error = law_error or vitals.law_error
        age = rejected = 0.0
        if state is not None:
            age, rejected = state.pose_age, state.rejected
        jumped = jump(self._before, samples)
        other = whose(jumped, samples, inputs.neighbours) if jumped > FAR else None
        self.fleet, self._law_error, self._other = vitals.fleet, law_error, other or ""
        self._before = state
        waited = overdue = 0.0
        if setpoint is not None:
            waited, overdue = effect_at - due_at(setpoint), effect_at - setpoint.valid_until
        oldest = 0.0
        for name, one in inputs.neighbours.items():
            if inputs.t - one.t > oldest:
                oldest, self._oldest = inputs.t - one.t, name
        leak, weak = self._evidence.open, self._evidence.weak
        may_leak = self._evidence.either[0]
        if state is not None and may_leak.sigmas > ALERT:
            self._nearby.look(inputs.t, state, inputs.neighbours)
        self._t = inputs.t
        return (
            abs(age),
            self._repeats.count(samples) if self._repeats is not None else 0,
            jumped,
            1.0 if other is not None else 0.0,
            rejected,
            waited,
            overdue,
            oldest,
            health.supply_pressure / self._set_pressure,
            self._tank_loss(inputs.t, health.tank_pressure),
            health.battery,
            health.silent_s,
            leak.size,
            leak.sigmas,
            self._evidence.either[0].sigmas,
            weak.sigmas,
            spare,
            1.0 if law_error else 0.0,
            0.0
            if is_number(commanded_wrench.fx, commanded_wrench.fy, commanded_wrench.tau)
            else 1.0,
            vitals.late_s,
            vitals.operator_age,
            abs(vitals.clock_offset),
            0.0 if vitals.same_config else 1.0,
            vitals.disk_free,
            vitals.foreign,
            0.0 if vitals.fleet is None else 1.0,
        )

    def said(self, detector: Detector) -> str:
        """Text for a detector's number at this tick, if it has one."""
        leak, weak = self._evidence.open, self._evidence.weak
        touched = self._nearby.contact(self._t)
        touched = touched and f"{touched} or "
        match detector:
            case Detector.JET_OPEN:
                return str(leak.jet + 1)
            case Detector.JET_LEAKS:
                return f"{touched}valve leaks? jet {leak.jet + 1} gives {leak.size:.0%}"
            case Detector.JET_MISSING:
                return str(weak.jet + 1)
            case Detector.JET_LEAKS_OR_WEAK:
                may_leak, or_weak = self._evidence.either
                other = "" if leak.gain > 0.0 else f" or jet {or_weak.jet + 1} gives too little"
                return f"{touched}jet {may_leak.jet + 1} leaks{other}"
            case Detector.LAW_ERROR:
                return self._law_error
            case Detector.POSE_OF_ANOTHER:
                return self._other
            case Detector.NEIGHBOUR_AGE:
                return self._oldest
            case Detector.FLEET:
                return "" if self.fleet is None else self.fleet.words
        return ""

    def _tank_loss(self, t: float, pressure: float) -> float:
        """Loss of the tank since the last tick, as a share of a full tank per second [1/s]."""
        before, self._tank = self._tank, (t, pressure)
        if before is None or t <= before[0]:
            return 0.0
        return (before[1] - pressure) / (self._full * (t - before[0]))
