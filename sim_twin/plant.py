"""The true motion of the fleet on the table, integrated from valve edge to valve edge.

Between two corners of any jet's flow the body wrench is linear in time (flow.py), so the plant
steps from corner to corner, not on a grid: pulse lengths are exact for any step. Steps are at most
`MAX_STEP` because of the tilt map and contact detection.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from sim_twin.air import breathe
from sim_twin.board import (
    LONG_AGO,
    SLOTS,
    Board,
    Driver,
    FirmwareBoard,
    Pulses,
    nanoseconds,
    no_pulses,
)
from sim_twin.body import Stages, no_stages, slide, step
from sim_twin.contact import Solids, closing, keys, resolve
from sim_twin.flow import pieces
from sim_twin.ground import Ground, lay
from sim_twin.plant_parameters import PlantParameters, sample_plant
from sim_twin.randomness import stream
from testbed.core.bundle import Bundle, unpacked
from testbed.core.compiled import compiled, inlined, with_fixed_types
from testbed.core.landing import GRAVITY, PADS
from testbed.core.table import Obstacle, Table
from testbed.core.types import Pose
from testbed.core.vehicle import Vehicle

Array = NDArray[np.float64]

MAX_STEP = 0.01  # [s]
HAIR = 1e-9  # [s] shorter pieces, left by rounding, join the previous one
REST = 0.002  # [s] between two checks of a persistent contact
BISECTIONS = 40  # of MAX_STEP, resolves 1e-14 s
FAR_AHEAD = 10**15  # [ns]


class Windows(NamedTuple):
    """Pieces of a window in which the wrench of a vehicle is linear in time; work memory."""

    cuts: Array  # (v, room + 1) beginnings, and the last one's end [s]
    value: Array  # (v, room, 4) see flow.pieces
    slope: Array  # (v, room, 4)
    pieces: NDArray[np.int64]  # how many, (v,)


class PlantArrays(NamedTuple):
    """The true vehicles and their table, for compiled code."""

    x: Array  # (v, 6) states, see body.py
    used: Array  # (v,) gas consumed [kg]
    impulse: Array  # (v,) total of all jets [N s]
    parameters: PlantParameters
    ground: Ground
    solids: Solids  # that can be hit
    last_touch: Array  # see contact.resolve
    touches: Array  # (n, 4) see contact.resolve
    windows: Windows
    stages: Stages
    before: tuple[Array, Array, Array]  # x, used and impulse before a step


@inlined
def drift(x, spent, stages, parameters, ground, windows, start, end):
    """Move every vehicle from `start` to `end` of the window, ignoring contacts."""
    cuts, value, slope, count = windows.cuts, windows.value, windows.slope, windows.pieces
    used, impulse = spent
    for v in range(x.shape[0]):
        for i in range(count[v]):
            a, b = max(start, cuts[v, i]), min(end, cuts[v, i + 1])
            if b <= a:
                continue
            h = b - a
            level, rate, since = value[v, i], slope[v, i], a - cuts[v, i]
            used[v], pushed = breathe(stages, level, rate, since, h, parameters, v, used[v])
            impulse[v] += pushed
            if parameters.grip[v, 0] > 0.0:
                slide(x[v], h, parameters.grip[v])
            else:
                drag, spin_drag = parameters.drag[v], parameters.spin_drag[v]
                step(x[v], h, stages, drag, spin_drag, parameters.hose[v], ground)


@compiled
def cut_windows(windows, pulses, parameters, origin, span):
    """Write `flow.pieces` of every vehicle."""
    for v in range(pulses.up.shape[0]):
        own = Pulses(pulses.up[v], pulses.down[v], pulses.strength[v])
        start, level, rate = pieces(
            own,
            parameters.timing[v],
            parameters.effect[v],
            parameters.thrust[v],
            parameters.droop[v],
            parameters.late[v],
            origin,
            span,
        )
        n = level.shape[0]
        windows.pieces[v] = n
        windows.cuts[v, : n + 1] = start
        windows.value[v, :n] = level
        windows.slope[v, :n] = rate


@compiled
def advance(arrays, pulses, origin, span, marks, seen):
    """Advance the fleet over one window, in place.

    Args:
        arrays: Bundle of PlantArrays.
        pulses: board.Pulses with a leading vehicle axis.
        origin: start of the window in the run [ns].
        span: length of the window [s].
        marks: increasing times of the run at which to record the states, shape (n,) [s].
        seen: written to: states at the marks, shape (n, v, 6).

    Returns:
        number of rows used in `touches`.
    """
    it = unpacked(arrays)
    x, used, impulse, parameters = it.x, it.used, it.impulse, it.parameters
    ground, solids, windows, stages = it.ground, it.solids, it.windows, it.stages
    before, spent = it.before, (used, impulse)  # `before`: a contact may cut the step short
    cut_windows(windows, pulses, parameters, origin, span)
    count, t = 0, 0.0
    resting = False
    for m in range(marks.shape[0] + 1):
        at = marks[m] - 1e-9 * origin if m < marks.shape[0] else span
        target = min(max(at, 0.0), span)
        while t < target:
            end = t + (REST if resting else MAX_STEP)
            if end > target - HAIR:
                end = target
            before[0][:], before[1][:], before[2][:] = x, used, impulse
            drift(x, spent, stages, parameters, ground, windows, t, end)
            if closing(x, parameters, ground, solids, origin * 1e-9 + end):
                low, high = t, end
                if not resting:
                    for _ in range(BISECTIONS):
                        middle = 0.5 * (low + high)
                        x[:], used[:], impulse[:] = before
                        drift(x, spent, stages, parameters, ground, windows, t, middle)
                        if closing(x, parameters, ground, solids, origin * 1e-9 + middle):
                            high = middle
                        else:
                            low = middle
                    x[:], used[:], impulse[:] = before
                    drift(x, spent, stages, parameters, ground, windows, t, high)
                now = origin * 1e-9 + high
                count = resolve(
                    x, parameters, used, ground, solids, now, it.last_touch, it.touches,
                    count,
                )  # fmt: skip
                resting = True
                t = high
            else:
                resting = False
                t = end
        if m < marks.shape[0]:
            seen[m] = x
    return count


class Touch(Struct, frozen=True):
    """A recorded contact, a collision on the real table."""

    t: float  # [s]
    vehicle: str
    other: str  # another vehicle, an obstacle or an edge
    speed: float  # closing [m/s]


class Plant:
    """The true state of the vehicles on the table, and its integration."""

    def __init__(
        self,
        vehicles: Mapping[str, Vehicle],
        starts: Mapping[str, Pose],
        table: Table,
        obstacles: Mapping[str, Obstacle],
        seed: int,
        drivers: Mapping[str, Driver] | None = None,
    ) -> None:
        self.names = list(vehicles)
        self._friction = [one.landing.friction for one in vehicles.values()]
        solid = {name: o for name, o in obstacles.items() if o.solid > 0.0}
        self._others = [*self.names, "right edge", "left edge", "upper edge", "lower edge", *solid]
        self.parameters = sample_plant(vehicles, seed, table.spread)
        self._ground = lay(table)
        self._solids = Solids(
            np.array([o.position for o in solid.values()], dtype=float).reshape(-1, 2),
            np.array([o.velocity for o in solid.values()], dtype=float).reshape(-1, 2),
            np.array([o.solid for o in solid.values()], dtype=float),
        )
        count = len(self.names)
        self.x = np.zeros((count, 6))
        self.x[:, :3] = [(starts[n].x, starts[n].y, starts[n].theta) for n in self.names]
        self.used = np.zeros(count)  # gas consumed [kg]
        self.impulse = np.zeros(count)  # total of all jets [N s]
        jets = self.parameters.thrust.shape[1]
        self._pulses = no_pulses(count, jets)
        self.boards: dict[str, Board | FirmwareBoard] = {}
        for k, (name, vehicle) in enumerate(vehicles.items()):
            own = vehicle, self._pulses_of(k), stream(seed, name, "pulses")
            self.boards[name] = FirmwareBoard(*own, drivers[name]) if drivers else Board(*own)
        self._stuck: dict[tuple[int, int], tuple[bool, int, int]] = {}
        self._leaky: dict[tuple[int, int], tuple[float, int, int]] = {}
        self._weak: dict[tuple[int, int], tuple[float, int, int]] = {}
        self.crossed: list[tuple[int, int]] = []  # pairs of vehicles with each other's boards
        last_touch = np.full((count, keys(count, len(solid))), -np.inf)
        room = 4 * jets * SLOTS + 1  # of pieces, mostly unused
        value, slope = np.empty((2, count, room, 4))
        windows = Windows(np.empty((count, room + 1)), value, slope, np.zeros(count, np.int64))
        before = self.x.copy(), self.used.copy(), self.impulse.copy()
        self._touched = np.empty((64, 4))
        self.arrays = Bundle(PlantArrays(
            self.x, self.used, self.impulse, self.parameters, self._ground, self._solids,
            last_touch, self._touched, windows, no_stages(), before,
        ))  # fmt: skip
        self.touches: list[Touch] = []
        self.t = 0.0  # [s]
        self._aloft: dict[int, tuple[Array, Array, float]] = {}  # of landed vehicles: jets, flow
        self.landed: dict[int, float] = {}  # vehicles without air: time of the shut-off [s]
        self._advance = with_fixed_types(advance)

    def _pulses_of(self, k: int) -> Pulses:
        return Pulses(self._pulses.up[k], self._pulses.down[k], self._pulses.strength[k])

    def stick(self, k: int, jet: int, is_open: bool, since: float, until: float) -> None:
        """Hold valve `jet` of vehicle `k` open or shut from `since` to `until`."""
        span = nanoseconds(since), min(FAR_AHEAD, nanoseconds(until))
        self._stuck[k, jet] = (is_open, *span)

    def leak_valve(self, k: int, jet: int, share: float, since: float, until: float) -> None:
        """Let valve `jet` of vehicle `k` pass a share of its flow when shut."""
        span = nanoseconds(since), min(FAR_AHEAD, nanoseconds(until))
        self._leaky[k, jet] = (share, *span)

    def weaken(self, k: int, jet: int, share: float, since: float, until: float) -> None:
        """Let valve `jet` of vehicle `k` pass only a share of its flow when open."""
        span = nanoseconds(since), min(FAR_AHEAD, nanoseconds(until))
        self._weak[k, jet] = (share, *span)

    def leak(self, k: int, gas: float) -> None:
        """Remove `gas` [kg] from the tank of vehicle `k`."""
        self.used[k] = min(self.used[k] + gas, self.parameters.gas[k])

    def land(self, k: int) -> None:
        """Shut off the air of vehicle `k` at the tank: jets and bearing air."""
        if k in self.landed:
            return
        p, slows = self.parameters, self._friction[k] * GRAVITY  # friction acts at once [assumed]
        self._aloft[k] = p.effect[k].copy(), p.thrust[k].copy(), float(p.bearing_flow[k])
        p.effect[k] = p.thrust[k] = p.bearing_flow[k] = 0.0
        p.grip[k] = slows, slows * PADS * p.radius[k] * p.mass[k] / p.inertia[k]
        self.landed[k] = self.t

    def lift(self, k: int) -> None:
        """Open the air of vehicle `k` again."""
        if k not in self.landed:
            return
        p = self.parameters
        p.effect[k], p.thrust[k], p.bearing_flow[k] = self._aloft.pop(k)
        p.grip[k] = 0.0
        del self.landed[k]

    @property
    def valves_healthy(self) -> bool:
        """Whether every valve does what its board commands."""
        return not (self._stuck or self._leaky or self._weak or self.crossed)

    def played(self) -> Pulses:
        """Actual valve pulses: the boards' commands, as wires and broken valves modify them."""
        if self.valves_healthy:
            return self._pulses
        ours = self._pulses
        played = Pulses(ours.up.copy(), ours.down.copy(), ours.strength.copy())
        for a, b in self.crossed:
            for mine, theirs in zip(played, ours, strict=True):
                mine[[a, b]] = theirs[[b, a]]
        for (k, jet), (is_open, since, until) in self._stuck.items():
            up, down = played.up[k, jet], played.down[k, jet]
            inside = (up >= since) & (up < until)
            up[inside] = down[inside] = LONG_AGO
            across = (up < since) & (down > since)
            down[across] = since
            if is_open:  # overwrites the oldest pulse
                up[0], down[0], played.strength[k, jet, 0] = since, until, 1.0
        for (k, jet), (share, since, until) in self._weak.items():
            up, down, strength = played.up[k, jet], played.down[k, jet], played.strength[k, jet]
            strength[(up >= since) & (up < until)] *= share
            # one that flows at `since` is cut: a valve that is held open has no later opening
            for one in 1 + np.flatnonzero((up[1:] < since) & (down[1:] > since)):
                up[0], down[0], strength[0] = since, down[one], share * strength[one]
                down[one] = since
        for (k, jet), (share, since, until) in self._leaky.items():
            up, down, strength = played.up[k, jet], played.down[k, jet], played.strength[k, jet]
            strength[(up >= since) & (up < until)] *= 1.0 - share  # the total is at most fully open
            flows = down[(up < since) & (down > since)].max(initial=since)  # and it was that before
            up[0], down[0], strength[0] = flows, until, share
        return played

    def vehicle_of_board(self, k: int) -> int:
        """The vehicle that the board of vehicle `k` is in."""
        others = [b if k == a else a for a, b in self.crossed if k in (a, b)]
        return others[0] if others else k

    def floats(self, k: int) -> bool:
        """Whether the bearing air of vehicle `k` is on."""
        return k not in self.landed

    @property
    def stands(self) -> bool:
        """Whether all motion has ended: all vehicles stand without air, no obstacle moves."""
        return bool(
            self.parameters.grip.all() and not self.x[:, 3:].any() and not self._solids.v.any()
        )

    def advance(
        self, t: float, marks: Array | Sequence[float] = (), *, boards: bool = True
    ) -> Array:
        """Advance to time `t` and return the states at the `marks`, (n, v, 6).

        Without `boards` the boards do not run and valves keep their state: firmware costs time even
        when idle.
        """
        for board in self.boards.values() if boards else ():
            board.run_until(t)
        origin, times = nanoseconds(self.t), np.asarray(marks, dtype=np.float64)
        span = 1e-9 * (nanoseconds(t) - origin)
        seen = np.empty((len(times), len(self.names), 6))
        count = self._advance(self.arrays, self.played(), origin, span, times, seen)
        self.note_window(t, count)
        for k, board in enumerate(self.boards.values()):
            if not board.floats:
                self.land(self.vehicle_of_board(k))
        return seen

    def note_window(self, t: float, touches: int) -> None:
        """Note that the vehicles are at time `t` [s], after so many new rows of touches."""
        for at, vehicle, other, speed in self._touched[:touches].tolist():
            self.touches.append(
                Touch(at, self.names[int(vehicle)], self._others[int(other)], speed)
            )
        self.t = t
