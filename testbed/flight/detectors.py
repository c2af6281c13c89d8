"""The detectors of the fault table: numbers that say how far something is from being well.

Each is a small piece that is handed what it looks at; only those that compare with what was before
have a memory. `Detectors.numbers` gives all of them, in the order of `faults.DETECTORS`.
"""

import math
from collections.abc import Mapping, Sequence

from testbed.core.types import Inputs, PoseSample, Setpoint, State, Trajectory, Wrench
from testbed.core.vehicle import Vehicle
from testbed.flight.gate import is_number
from testbed.flight.jet_faults import Array, JetFaultDetector, Suspicion

SAME_PLACE = 0.15  # [m] a pose so near to where another vehicle should be is that one's
TRUSTED_AGE = 0.1  # [s]
TRUSTED = 8  # poses refused in a row
SAME_CLOCK = 0.005  # [s]
FAR = 0.05  # [m] a pose so far from the own prediction is not the own


class Repeats:
    """How often the cameras have said exactly the same."""

    def __init__(self) -> None:
        self._last: PoseSample | None = None
        self._count = 0

    def count(self, samples: Sequence[PoseSample]) -> int:
        """Equal poses in a row, after these; 0: the newest differs from the one before."""
        last, count = self._last, self._count
        for s in samples:
            same = last is not None and s.x == last.x and s.y == last.y and s.theta == last.theta
            last, count = s, count + 1 if same else 0
        self._last, self._count = last, count
        return count


def place(state: State, t: float) -> tuple[float, float]:
    """Where a vehicle is at `t` if it just goes on."""
    h = t - state.t
    return state.pose.x + h * state.twist.vx, state.pose.y + h * state.twist.vy


def jump(before: State | None, samples: Sequence[PoseSample]) -> float:
    """Distance of the newest pose from where the last estimate expected it [m]."""
    if before is None or not samples:
        return 0.0
    newest = samples[-1]
    x, y = place(before, newest.captured_at)
    return math.hypot(newest.x - x, newest.y - y)


def whose(
    jumped: float, samples: Sequence[PoseSample], neighbours: Mapping[str, State]
) -> str | None:
    """The other vehicle that the newest pose shows, if it shows one."""
    if jumped <= FAR or not samples:
        return None
    newest = samples[-1]
    for name, state in neighbours.items():
        x, y = place(state, newest.captured_at)
        if math.hypot(newest.x - x, newest.y - y) < min(SAME_PLACE, jumped):
            return name
    return None


def due_at(setpoint: Setpoint) -> float:
    """The instant that a setpoint begins to be for [s]."""
    return setpoint.references[0].t if isinstance(setpoint, Trajectory) else setpoint.t


class Detectors:
    """All of them, for one vehicle."""

    def __init__(self, vehicle: Vehicle, evidence: JetFaultDetector, *, noisy: bool) -> None:
        """`noisy` cameras never say the same twice; others may, of a vehicle at rest."""
        self._set_pressure, self._full = vehicle.air.set_pressure, vehicle.air.tank_pressure
        self._tank: tuple[float, float] | None = None  # time [s] and pressure [Pa] at the last tick
        self._repeats = Repeats() if noisy else None
        self._evidence = evidence
        self._before: State | None = None
        self.said: dict[str, str] = {}  # words to the numbers, where there are any

    def compare(self, inputs: Inputs, state: State, duty: Array, thrust_scale: float) -> None:
        """Compare the motion with what the last plan let flow; see `Evidence.look`.

        Poses that are old, refused or of another clock say nothing about valves.
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
        """How it is now.

        Args:
            inputs: of this tick.
            state: estimate for `effect_at`.
            setpoint: to be flown.
            commanded_wrench: by law or tracker.
            effect_at: when the next plan begins to act [s].
            spare: room left after a full stop [m].
            law_error: what the law died of.
        """
        vitals, health, samples = inputs.vitals, inputs.health, inputs.samples
        age = rejected = 0.0
        if state is not None:
            age, rejected = state.pose_age, state.rejected
        jumped = jump(self._before, samples)
        other = whose(jumped, samples, inputs.neighbours) if jumped > FAR else None
        self._before = state
        waited = overdue = 0.0
        if setpoint is not None:
            waited, overdue = effect_at - due_at(setpoint), effect_at - setpoint.valid_until
        oldest = 0.0
        for name, one in inputs.neighbours.items():
            if inputs.t - one.t > oldest:
                oldest, self.said["neighbour_age"] = inputs.t - one.t, name
        leak, weak, either = self._suspicions()
        law_error = law_error or vitals.law_error
        if law_error or other or vitals.fleet:
            self.said |= {
                "law_error": law_error,
                "pose_of_another": other or "",
                "fleet": vitals.fleet,
            }
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
            either,
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
            1.0 if vitals.fleet else 0.0,
        )

    def _suspicions(self) -> tuple[Suspicion, Suspicion, float]:
        """Which jet leaks, which gives too little, and how sure it is that one of them does."""
        evidence, said = self._evidence, self.said
        leak, weak = evidence.open, evidence.weak
        if leak.gain > 0.0:
            said["jet_open"] = str(leak.jet + 1)
            said["jet_leaks"] = f"{leak.jet + 1} gives {leak.size:.0%}"
        if weak.gain > 0.0:
            said["jet_missing"] = str(weak.jet + 1)
        may_leak, or_weak = evidence.either
        if may_leak.gain > 0.0:
            said["jet_leaks_or_weak"] = f"jet {may_leak.jet + 1} leaks"
            if leak.gain == 0.0:
                said["jet_leaks_or_weak"] += f" or jet {or_weak.jet + 1} gives too little"
        return leak, weak, may_leak.sigmas

    def _tank_loss(self, t: float, pressure: float) -> float:
        """Share of a full tank that has gone per second since the last tick [1/s]."""
        before, self._tank = self._tank, (t, pressure)
        if before is None or t <= before[0]:
            return 0.0
        return (before[1] - pressure) / (self._full * (t - before[0]))
