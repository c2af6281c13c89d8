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
from sim_twin.lab_faults import Late, moved, turned
from sim_twin.plant import Plant
from sim_twin.randomness import stream
from testbed.core.fault_injection import OF_FRAME, Injection
from testbed.core.landing import PADS
from testbed.core.table import Obstacle
from testbed.core.types import ALL_WELL, PoseSample, Vitals

Array = NDArray[np.float64]

REACH = 0.2  # of markers from the body's middle: noise of positions over that of headings [m]
DEAD_BATTERY = 7.0  # [V] battery voltage that a board reports during a brown-out
NEVER = math.inf
HAIR = 1e-9  # [s]
HEIGHT = 0.2  # [m] of the markers, which cameras with their y axis up show as y
# these change the vehicle itself, from the next window on
OF_VEHICLE = ("swap_jets", "reverse_jet", "hose", "pad_drag", "regulator", "thrust", "mass")


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
        self._late = {name: Late() for name in plant.names}
        self._last_frame: dict[str, float] = {}  # of slow cameras [s]
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
                case "weak_jet":
                    self._plant.weaken(k, what.jet - 1, what.size, one.since, over)
                case "half_open":
                    self._plant.stick(k, what.jet - 1, False, one.since, over)
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
            if what.vehicle != name or not one.holds(self._plant.t + HAIR):
                continue
            match what.kind:
                case "thrust" | "regulator":
                    effect *= what.size
                    thrust *= what.size
                case "mass":
                    plant.mass[k] *= what.size
                case "swap_jets":
                    pair, other = [jet, round(what.size) - 1], [round(what.size) - 1, jet]
                    effect[:, pair], thrust[pair] = effect[:, other], thrust[other]
                case "reverse_jet":
                    effect[:, jet] *= -1.0
                case "hose":
                    way = math.radians(what.towards_deg)
                    plant.hose[k, 0] += what.size * math.cos(way)
                    plant.hose[k, 1] += what.size * math.sin(way)
                case "pad_drag":
                    plant.drag[k] += what.size
                    plant.spin_drag[k] += what.size * (PADS * plant.radius[k]) ** 2

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

    def poses(self, name: str, samples: Sequence[PoseSample]) -> Sequence[PoseSample]:
        """A vehicle's poses after camera faults."""
        seen = samples
        for one in self._active:
            if one.what.vehicle == name or one.what.kind in OF_FRAME:
                seen = [s for each in seen if (s := self._spoil(name, one, each)) is not None]
        return seen

    def _spoil(self, name: str, one: ActiveInjection, s: PoseSample) -> PoseSample | None:
        """A pose after one fault; None: it is lost."""
        what, at = one.what, s.captured_at
        size, holds = what.size, one.holds(at)
        match what.kind:
            case "freeze_mocap":
                return self._freeze(name, s, size, holds=holds)
            case "delay_mocap":
                return self._late[name].pose(s, size if holds else 0.0)
            case "clock_step" if one.holds(self._now):
                return PoseSample(at - size, s.x, s.y, s.theta)
            case _ if not holds:
                return s
            case "drop_mocap":
                return None
            case "jump_mocap":
                return moved(s, size, 0.0)
            case "noisy_mocap":
                return moved(s, *(size * self._rng.standard_normal(2)).tolist())
            case "turn_body":
                return turned(s, math.radians(size))
            case "turn_frame":
                turn = math.radians(size)
                c, d = math.cos(turn), math.sin(turn)
                dx, dy = (c - 1.0) * s.x - d * s.y, d * s.x + (c - 1.0) * s.y
                return moved(turned(s, turn), dx, dy)
            case "shift_frame" | "creep_frame":
                far = size * (at - one.since if what.kind == "creep_frame" else 1.0)
                way = math.radians(what.towards_deg)
                return moved(s, far * math.cos(way), far * math.sin(way))
            case "scale_frame":
                return PoseSample(at, size * s.x, size * s.y, s.theta)
            case "tip_frame":
                return PoseSample(at, s.x, HEIGHT, 0.0)
            case "slow_mocap":
                if at - self._last_frame.get(name, -NEVER) < 1.0 / size - HAIR:
                    return None
                self._last_frame[name] = at
        return s

    def _freeze(self, name: str, s: PoseSample, dither: float, *, holds: bool) -> PoseSample:
        if not holds or name not in self._frozen:
            self._frozen[name] = s
        last = self._frozen[name]
        still = PoseSample(s.captured_at, last.x, last.y, last.theta)
        if not (holds and dither):
            return still
        dx, dy, turn = (dither * self._rng.standard_normal(3)).tolist()
        return moved(turned(still, turn / REACH), dx, dy)

    def radio(self, receiver: str) -> tuple[float, float]:
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

    def power(self, name: str, battery: float) -> tuple[float, float]:
        """Battery voltage, of a true one without faults [V], and the board's silence [s]."""
        if flat := self.found(name, "flat_battery"):
            return flat.size, 0.0
        for one in self._active:
            if one.what.kind == "brown_out" and one.what.vehicle == name and one.since <= self._now:
                # a board that has rebooted does not fly on, which looks like silence here
                volts = DEAD_BATTERY if one.holds(self._now) else battery
                return volts, self._now - one.since
        return battery, 0.0

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
