"""Injected faults in the twin: their effect on cameras, radio, board and process.

The parts of the twin query `FaultInjector` for active faults. Camera faults begin with the first
frame exposed after their time, those of board and valves at exactly their time, those of a process
with its next tick. Those that change the vehicle itself (`OF_VEHICLE`) begin with the next window
of the plant.
"""

import math
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from sim_twin.board import Board
from sim_twin.plant import Plant
from sim_twin.randomness import stream
from testbed.core.fault_injection import OF_FRAME, Injection
from testbed.core.se2 import wrap
from testbed.core.table import Obstacle
from testbed.core.types import ALL_WELL, PoseSample, Vitals

Array = NDArray[np.float64]

DEAD_BATTERY = 7.0  # [V] battery voltage that a board reports during a brown-out
NEVER = math.inf
HEIGHT = 0.2  # [m] of the markers, which cameras with their y axis up show as y
OF_VEHICLE = ("weak_jet", "weak_jets", "swap_jets", "reverse_jet", "hose", "drag_pad", "regulator")


class ActiveInjection:
    """An injection and its start time."""

    def __init__(self, what: Injection) -> None:
        self.what = what
        self.since = NEVER if what.at_s is None else what.at_s

    def holds(self, t: float) -> bool:
        """Whether it is in force at `t` [s]."""
        return self.since <= t < self.since + self.what.for_s


class FaultInjector:
    """All injected faults of a run and their state."""

    def __init__(
        self,
        injections: Sequence[Injection],
        plant: Plant,
        obstacles: Mapping[str, Obstacle],
        half: tuple[float, float],
        seed: int,
        *,
        boards: bool = True,
    ) -> None:
        """With `boards` the boards are modelled and power loss is injected here, not by the rig."""
        self._boards = boards
        self._plant, self._half = plant, half
        self._obstacles = [
            (*obstacle.position, *obstacle.velocity) for obstacle in obstacles.values()
        ]
        self._active = [ActiveInjection(one) for one in injections]
        self._frozen: dict[str, PoseSample] = {}
        self._shown: dict[str, list[PoseSample]] = {}  # of `delay_mocap`, the oldest first
        self._kept_at: dict[str, float] = {}  # of `slow_mocap` [s]
        as_drawn = plant.parameters
        self._drawn = {
            what.vehicle: [column[plant.names.index(what.vehicle)].copy() for column in as_drawn]
            for what in injections
            if what.kind in OF_VEHICLE
        }
        self._rng = stream(
            seed, "sabotage"
        )  # a label of the random stream: another one changes flights
        self._now = 0.0

    def reseed(self, seed: int) -> None:
        """Draw other random numbers from now on."""
        self._rng = stream(seed, "sabotage")

    def began(self) -> list[float]:
        """Start time of each injection, in order; infinite: not yet begun [s]."""
        return [one.since for one in self._active]

    def look(self, t: float) -> None:
        """Start injections whose event has occurred by time `t`."""
        self._now = t
        for one in self._active:
            if one.since == NEVER and self._happens(one.what, t):
                one.since = t

    def before(self, until: float) -> None:
        """Apply to the plant the faults that begin before `until`, to which it advances next."""
        for name in self._drawn:
            self._change(name)
        self._plant.crossed = [
            (self._plant.names.index(one.what.vehicle), self._plant.names.index(one.what.other))
            for one in self._active
            if one.what.kind == "swap_boards" and one.holds(self._plant.t)
        ]
        for one in self._active:
            what = one.what
            if not one.since < until:
                continue
            k = self._plant.names.index(what.vehicle)
            over = one.since + what.for_s
            match what.kind:
                case "stick_open" | "stick_closed":
                    self._plant.stick(k, what.jet - 1, what.kind == "stick_open", one.since, over)
                case "leak_valve":
                    self._plant.leak_valve(k, what.jet - 1, what.size, one.since, over)
                case "kill_process" if isinstance(board := self._plant.boards[what.vehicle], Board):
                    board.fall_silent(one.since, over)
                case "brown_out" if self._boards:
                    board = self._plant.boards[what.vehicle]
                    assert isinstance(board, Board), "the configuration refuses it"
                    board.lose_power(one.since, NEVER)  # afterwards it is SAFE and plays nothing
                    if self._plant.t >= one.since:  # normally closed, as the jets' valves are
                        self._plant.land(k)
                case "leak":
                    span = min(until, over) - max(one.since, self._plant.t)
                    self._plant.leak(k, what.size * max(0.0, span))
                case "empty_tank":
                    self._plant.leak(k, math.inf)

    def _change(self, name: str) -> None:
        """Set a vehicle's parameters to the drawn ones, changed by the faults in force."""
        k, plant = self._plant.names.index(name), self._plant.parameters
        if not self._plant.floats(k):  # its jets have no air
            return
        for column, drawn in zip(plant, self._drawn[name], strict=True):
            column[k] = drawn
        effect, thrust = plant.effect[k], plant.thrust[k]
        for one in self._active:
            what, jet = one.what, one.what.jet - 1
            if what.vehicle != name or not one.holds(self._plant.t):
                continue
            match what.kind:
                case "weak_jet":
                    effect[:, jet] *= what.size
                    thrust[jet] *= what.size
                case "weak_jets" | "regulator":
                    effect *= what.size
                    thrust *= what.size
                case "swap_jets":
                    pair, other = [jet, round(what.size) - 1], [round(what.size) - 1, jet]
                    effect[:, pair], thrust[pair] = effect[:, other], thrust[other]
                case "reverse_jet":
                    effect[:, jet] *= -1.0
                case "hose":
                    plant.hose[k, 0] += what.size
                case "drag_pad":
                    plant.drag[k] += what.size

    def found(self, vehicle: str, *kinds: str) -> Injection | None:
        """The first active injection of these kinds on this vehicle."""
        for one in self._active:
            what = one.what
            if what.kind in kinds and what.vehicle == vehicle and one.holds(self._now):
                return what
        return None

    def sources(self, names: Sequence[str], times: Array) -> list[list[int]] | None:
        """For each exposure, the body that each name shows; None: each name its own body."""
        swaps = [one for one in self._active if one.what.kind == "swap_bodies"]
        if not any(one.holds(t) for one in swaps for t in times.tolist()):
            return None
        rows = []
        for t in times.tolist():
            row = list(range(len(names)))
            for one in swaps:
                if one.holds(t):
                    a, b = names.index(one.what.vehicle), names.index(one.what.other)
                    row[a], row[b] = row[b], row[a]
            rows.append(row)
        return rows

    def poses(self, name: str, samples: list[PoseSample]) -> list[PoseSample]:
        """A vehicle's poses after camera faults."""
        seen = samples
        for one in self._active:
            what = one.what
            if what.vehicle != name and what.kind not in OF_FRAME:
                continue
            match what.kind:
                case "drop_mocap":
                    seen = [s for s in seen if not one.holds(s.captured_at)]
                case "freeze_mocap":
                    seen = [self._freeze(name, s, one) for s in seen]
                case "slow_mocap":
                    seen = [
                        s for s in seen if not one.holds(s.captured_at) or self._keep(name, s, one)
                    ]
                case "delay_mocap":
                    seen = [self._older(name, s, one) for s in seen]
                case kind if kind in ("turn_mocap", *OF_FRAME):
                    seen = [
                        _displaced(s, what, s.captured_at - one.since)
                        if one.holds(s.captured_at) else s
                        for s in seen
                    ]  # fmt: skip
                case "jump_mocap":
                    seen = [
                        _moved(s, what.size, 0.0) if one.holds(s.captured_at) else s for s in seen
                    ]
                case "noisy_mocap":
                    seen = [
                        _moved(s, *(what.size * self._rng.standard_normal(2)).tolist())
                        if one.holds(s.captured_at) else s
                        for s in seen
                    ]  # fmt: skip
                case "clock_step":
                    if one.holds(self._now):
                        seen = [
                            PoseSample(s.captured_at - what.size, s.x, s.y, s.theta) for s in seen
                        ]
        return seen

    def _freeze(self, name: str, sample: PoseSample, one: ActiveInjection) -> PoseSample:
        if not one.holds(sample.captured_at) or name not in self._frozen:
            self._frozen[name] = sample
            return sample
        last = self._frozen[name]
        still = PoseSample(sample.captured_at, last.x, last.y, last.theta)
        if one.what.size == 0.0:
            return still
        return _moved(still, *(one.what.size * self._rng.standard_normal(2)).tolist())

    def _older(self, name: str, sample: PoseSample, one: ActiveInjection) -> PoseSample:
        """The pose of some time ago with the stamp of now."""
        shown = self._shown.setdefault(name, [])
        shown.append(sample)
        while len(shown) > 1 and shown[1].captured_at <= sample.captured_at - one.what.size:
            del shown[0]
        if not one.holds(sample.captured_at):
            return sample
        old = shown[0]
        return PoseSample(sample.captured_at, old.x, old.y, old.theta)

    def _keep(self, name: str, sample: PoseSample, one: ActiveInjection) -> bool:
        """Whether cameras at the injected rate show this frame."""
        if sample.captured_at - self._kept_at.get(name, -NEVER) < 1.0 / one.what.size:
            return False
        self._kept_at[name] = sample.captured_at
        return True

    def air(self, receiver: str) -> tuple[float, float]:
        """Injected delay [s] and loss probability of messages to a vehicle."""
        late, lost = self.found(receiver, "delay_link"), self.found(receiver, "lose_link")
        return late.size if late else 0.0, lost.size if lost else 0.0

    def dead(self, name: str) -> bool:
        """Whether the vehicle's process has ended."""
        return self.found(name, "kill_process") is not None

    def spoilt(self, name: str) -> str:
        """Injected fault of the law: "nan", "raise" or empty."""
        what = self.found(name, "nan_law", "raise_law")
        return what.kind.removesuffix("_law") if what else ""

    def power(self, name: str) -> tuple[float, float]:
        """Battery voltage [V] and time since the board's last message [s]."""
        if flat := self.found(name, "flat_battery"):
            return flat.size, 0.0
        for one in self._active:
            if one.what.kind == "brown_out" and one.what.vehicle == name and one.since <= self._now:
                # a board that has rebooted does not fly on, which looks like silence here
                return DEAD_BATTERY if one.holds(self._now) else 12.0, self._now - one.since
        return 12.0, 0.0

    def supply(self, name: str, pressure: float) -> float:
        """The supply pressure that the board reads, of a true one without faults [Pa]."""
        if self.found(name, "empty_tank"):
            return 0.0
        changed = self.found(name, "regulator", "sag")
        return pressure * changed.size if changed else pressure

    def vitals(self, name: str) -> Vitals:
        """Health of the vehicle's process."""
        clock, late = self.found(name, "clock_step"), self.found(name, "overrun")
        absent = [
            self._now - one.since for one in self._active
            if one.what.kind == "operator_gone" and one.holds(self._now)
        ]  # fmt: skip
        full, differs = self.found(name, "disk_full"), self.found(name, "config_differs")
        if not (clock or late or absent or full or differs):
            return ALL_WELL
        return Vitals(
            operator_age=max(absent, default=0.0),
            clock_offset=clock.size if clock else 0.0,
            late_s=late.size if late else 0.0,
            disk_free=0.0 if full else ALL_WELL.disk_free,
            same_config=differs is None,
        )

    def _happens(self, what: Injection, t: float) -> bool:
        x, y, _, vx, vy, _ = self._plant.x[self._plant.names.index(what.vehicle)].tolist()
        limit = what.threshold or 0.0
        match what.event:
            case "near_obstacle":
                gaps = [
                    math.hypot(px + t * wx - x, py + t * wy - y)
                    for px, py, wx, wy in self._obstacles
                ]
                return min(gaps, default=NEVER) < limit
            case "near_vehicle":
                others = [
                    math.hypot(row[0] - x, row[1] - y)
                    for name, row in zip(self._plant.names, self._plant.x.tolist(), strict=True)
                    if name != what.vehicle
                ]
                return min(others, default=NEVER) < limit
            case "near_edge":
                return min(self._half[0] - abs(x), self._half[1] - abs(y)) < limit
            case "faster_than":
                return math.hypot(vx, vy) > limit
        return False


def _moved(sample: PoseSample, dx: float, dy: float) -> PoseSample:
    return PoseSample(sample.captured_at, sample.x + dx, sample.y + dy, sample.theta)


def _displaced(sample: PoseSample, what: Injection, since: float) -> PoseSample:
    """A pose as cameras with another frame show it, `since` [s] after the fault began."""
    t, x, y, theta = sample.captured_at, sample.x, sample.y, sample.theta
    turn = math.radians(what.size)
    match what.kind:
        case "turn_mocap":
            return PoseSample(t, x, y, wrap(theta + turn))
        case "turn_frame":
            cos, sin = math.cos(turn), math.sin(turn)
            return PoseSample(t, cos * x - sin * y, sin * x + cos * y, wrap(theta + turn))
        case "scale_frame":
            return PoseSample(t, what.size * x, what.size * y, theta)
        case "tip_frame":
            return PoseSample(t, x, HEIGHT, 0.0)
    return _moved(sample, what.size * (since if what.kind == "creep_frame" else 1.0), 0.0)
