"""The dashboard's plots, jets and valves, each with the time of its message.

The result does not depend on how many messages are drawn at once.
"""

import math
from collections.abc import Sequence

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from testbed.config.experiment import Experiment
from testbed.core.types import HostTick, State, Tick
from testbed.dashboard.limits import plot_limits
from testbed.dashboard.scene_wires import VALVE_STATES
from testbed.dashboard.static_scene import FLAME, LAYER, PLUME
from testbed.logs.feed import Loop, News

Array = NDArray[np.float64]

MEAN_S = 1.0  # averaging time of forces: single pulses last milliseconds


class PlotScene:
    """Draws plots, jets and valves of one run."""

    def __init__(self, scenario: Experiment, recording: rr.RecordingStream) -> None:
        self._scenario, self._rec = scenario, recording
        self._names = list(scenario.vehicles)
        self._open: dict[tuple[str, int], bool] = {}
        self._lit: set[str] = set()  # vehicles whose plume geometry is drawn
        self._renewed: dict[str, tuple[float, float]] = {}
        self._means: dict[str, tuple[float, float]] = {}
        self._limits = plot_limits(scenario)

    def draw(self, news: Sequence[News]) -> None:
        """Add new ticks to the plots."""
        ticks: dict[str, list[Tick]] = {}
        hosts: dict[str, list[HostTick]] = {}
        loops: list[Loop] = []
        for one in news:
            match one.message:
                case Tick() as tick:
                    ticks.setdefault(one.who, []).append(tick)
                case HostTick() as host:
                    hosts.setdefault(one.who, []).append(host)
                case Loop() as loop:
                    loops.append(loop)
        for name, flown in ticks.items():
            if name in self._names:
                self._ticks(name, flown)
        for name, own in hosts.items():
            self._heard(name, own)
        if loops:
            self._column("plot/loop/late", [o.t for o in loops], [1e3 * o.late_s for o in loops])
            self._column("plot/loop/busy", [o.t for o in loops], [1e3 * o.busy_s for o in loops])

    def _column(self, path: str, t: Sequence[float], values: Sequence[float]) -> None:
        self._rec.send_columns(
            path, [rr.TimeColumn("t", duration=t)], rr.Scalars.columns(scalars=values)
        )

    def _ticks(self, name: str, flown: list[Tick]) -> None:
        """Draw all plots of one vehicle's ticks."""
        setup, t = self._scenario.vehicles[name], [tick.inputs.t for tick in flown]
        period = self._scenario.flight.jet_period_s
        outs = [tick.outputs for tick in flown]
        for path, wrenches in (
            (f"plot/force/{name}", [o.commanded_wrench for o in outs]),
            (f"plot/force/{name}_delivered", [o.realised_wrench for o in outs]),
        ):
            forces = self._mean(path, [(w.fx, w.fy) for w in wrenches], period)
            self._column(path, t, forces)
        health = [tick.inputs.health for tick in flown]
        self._column(f"plot/supply/{name}", t, [h.supply_pressure / 1e3 for h in health])
        self._column(
            f"plot/gas/{name}",
            t,
            [100.0 * h.tank_pressure / setup.model.air.tank_pressure for h in health],
        )
        self._column(
            f"plot/filter/{name}",
            t,
            [math.hypot(o.filtered.dfx_w, o.filtered.dfy_w) if o.filtered else 0.0 for o in outs],
        )
        known = [(tick.inputs.t, tick.outputs.state) for tick in flown if tick.outputs.state]
        seen = [(at, s) for at, s in known if s is not None]
        if seen:
            at = [a for a, _ in seen]
            self._column(f"plot/pose_age/{name}", at, [1e3 * s.pose_age for _, s in seen])
            self._column(
                f"plot/speed/{name}",
                at,
                [1e3 * math.hypot(s.twist.vx, s.twist.vy) for _, s in seen],
            )
            self._clearances(name, seen)
        if name == self._names[0]:
            for limit in self._limits:
                self._column(limit.path, t, [limit.value] * len(t))
        self._jets(name, flown, period)
        self._valves(name, flown, setup.model.command_delay_s)

    def _mean(self, path: str, forces: list[tuple[float, float]], period: float) -> list[float]:
        """Magnitude of a force, averaged over about the last MEAN_S."""
        weight = min(1.0, period / MEAN_S)
        x, y = self._means.get(path, forces[0])
        out = []
        for fx, fy in forces:
            x, y = x + weight * (fx - x), y + weight * (fy - y)
            out.append(math.hypot(x, y))
        self._means[path] = (x, y)
        return out

    def _clearances(self, name: str, seen: list[tuple[float, State]]) -> None:
        obstacles = list(self._scenario.obstacles.values())
        if not obstacles:
            return
        gaps = [
            min(
                math.hypot(
                    s.pose.x - r.position[0] - t * r.velocity[0],
                    s.pose.y - r.position[1] - t * r.velocity[1],
                )
                - r.radius
                for r in obstacles
            )
            for t, s in seen
        ]
        self._column(f"plot/clearance/{name}", [t for t, _ in seen], gaps)

    def _jets(self, name: str, flown: list[Tick], period: float) -> None:
        """Draw plumes, with a length proportional to the jet's duty cycle."""
        jets = self._scenario.vehicles[name].model.jets
        if not jets:
            return
        at = np.array([j.position for j in jets])
        push = np.array([j.push for j in jets])
        side = np.stack([-push[:, 1], push[:, 0]], axis=1)
        share = np.array([t.outputs.command.on_us for t in flown]) * 1e-6 / period  # (n, jets)
        length = np.where(share > 0.0, 0.25 + 0.75 * np.sqrt(np.minimum(share, 1.0)), 0.0) * PLUME
        n, m = share.shape
        points = np.full((n, m, 3, 3), LAYER["jet"])
        lit = (share > 0.0)[..., None]
        points[:, :, 0, :2] = at + np.where(lit, 0.022 * side, 0.0)
        points[:, :, 1, :2] = at - np.where(lit, 0.022 * side, 0.0)
        points[:, :, 2, :2] = at - length[..., None] * push
        times = [tick.inputs.t for tick in flown]
        self._raster(name, np.array(times), share)
        if name not in self._lit:
            self._lit.add(name)
            self._rec.log(
                f"world/vehicle/{name}/jets",
                rr.Mesh3D.from_fields(
                    triangle_indices=[(3 * j, 3 * j + 1, 3 * j + 2) for j in range(m)],
                    albedo_factor=[*FLAME, 255],
                ),
                static=True,
            )
        self._rec.send_columns(
            f"world/vehicle/{name}/jets",
            [rr.TimeColumn("t", duration=times)],
            rr.Mesh3D.columns(vertex_positions=points.reshape(-1, 3)).partition([3 * m] * n),
        )

    def _raster(self, name: str, times: Array, share: Array) -> None:
        """Draw a dot per pulse in row 10 k + jet of the k-th vehicle, larger for longer pulses."""
        row = 10.0 * (1 + self._names.index(name))
        for jet in range(share.shape[1]):
            is_open = share[:, jet] > 0.0
            at, part = times[is_open], np.minimum(share[is_open, jet], 1.0)
            if len(at):
                self._rec.send_columns(
                    f"plot/valve/{name}_{jet + 1}",
                    [rr.TimeColumn("t", duration=at)],
                    [*rr.Scalars.columns(scalars=np.full(len(at), row + jet + 1)),
                     *rr.SeriesPoints.columns(marker_sizes=1.5 + 3.0 * np.sqrt(part))],
                )  # fmt: skip

    def _valves(self, name: str, flown: list[Tick], delay: float) -> None:
        """Draw the opening and closing of each valve."""
        for jet in range(len(self._scenario.vehicles[name].model.jets)):
            times, states = [], []
            for tick in flown:
                command = tick.outputs.command
                if command.on_us[jet] > 0:
                    opened = tick.inputs.t + delay + 1e-6 * command.offset_us[jet]
                    times += [opened, opened + 1e-6 * command.on_us[jet]]
                    states += ["open", "shut"]
            if (name, jet) not in self._open:
                self._open[name, jet] = True
                self._rec.log(f"valve/{name}/jet_{jet + 1}", VALVE_STATES, static=True)
                times, states = [0.0, *times], ["shut", *states]
            if times:
                self._rec.send_columns(
                    f"valve/{name}/jet_{jet + 1}",
                    [rr.TimeColumn("t", duration=times)],
                    rr.StateChange.columns(state=states),
                )

    def _heard(self, name: str, ticks: list[HostTick]) -> None:
        """Draw age and loss of the states that the host receives from a vehicle."""
        rows = [(h.inputs.t, h.inputs.own) for h in ticks if h.inputs.own is not None]
        if rows:
            t = [at for at, _ in rows]
            self._column(f"plot/link/{name}", t, [1e3 * (at - own.t) for at, own in rows])
            lost = self._lost(name, [(at, own.t) for at, own in rows])
            self._column(f"plot/loss/{name}", t, lost)

    def _lost(self, name: str, ages: list[tuple[float, float]]) -> list[float]:
        """Share of ticks without a new message, over some seconds [%]."""
        share, newest = self._renewed.get(name, (0.0, -1.0))
        out = []
        for _, stamp in ages:
            share += 0.02 * ((0.0 if stamp > newest else 100.0) - share)
            newest = stamp
            out.append(share)
        self._renewed[name] = (share, newest)
        return out
