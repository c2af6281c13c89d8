"""The dashboard's picture: the table from above, drawn with rerun in its own process.

Entities:  world/...  the table, to scale in metres;  plot/...  scalars;  valve/...  on and off;
event  text;  banner  what state everybody is in. One timeline, `t`, the time of the run.

Everything goes in as columns, many ticks at once: that costs a hundredth of logging them one by
one, and a run that is opened later looks as it did live.
"""

import math
from collections.abc import Mapping, Sequence
from typing import get_args

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from testbed.core.types import State
from testbed.dashboard.scene_goals import AimScene
from testbed.dashboard.scene_wires import VALVE_STATES, WireScene
from testbed.dashboard.static_scene import (
    FLAME,
    LAYER,
    PLUME,
    RED,
    TRAIL,
    WHITE,
    circle,
    hue,
    obstacles,
    plain,
    setting,
)
from testbed.flight.faults import Response
from testbed.logs.feed import Loop, News, SeenHost, SeenTick, pose_of, stopping_point
from testbed.logs.history import events
from testbed.logs.recorder import Motion, Truth
from testbed.report.scenario import Scenario, law_of, range_of

Array = NDArray[np.float64]


TROUBLE = ("valves shut", "fault", *get_args(Response))  # how bad news begins
MEAN_S = 1.0  # of forces: pulses of milliseconds say little by themselves


def grouped(states: Mapping[str, str]) -> list[str]:
    """Those who are in the same state together, so that a banner is one line."""
    names: dict[str, list[str]] = {}
    for name, words in states.items():
        names.setdefault(words, []).append(name)
    return [f"**{', '.join(who)}** {words}" for words, who in names.items()]


class Scene:
    """What has been drawn so far of one run."""

    def __init__(self, scenario: Scenario, recording: rr.RecordingStream) -> None:
        self._scenario, self._rec = scenario, recording
        self._names = list(scenario.vehicles)
        self._trails: dict[str, list[tuple[float, float, float]]] = {n: [] for n in self._names}
        self._last: dict[str, SeenTick] = {}
        self._open: dict[tuple[str, int], bool] = {}
        self._said = ""
        self._renewed: dict[str, tuple[float, float]] = {}
        self._means: dict[str, tuple[float, float]] = {}
        self._places: dict[str, tuple[float, float]] = {}
        self._wires = WireScene(scenario, recording)
        self._aims_of = AimScene(scenario, recording)
        self.now = 0.0
        setting(recording, scenario)

    # What moves

    def draw(self, news: Sequence[News]) -> None:
        """Take in what has come."""
        ticks: dict[str, list[SeenTick]] = {}
        hosts: dict[str, list[SeenHost]] = {}
        truths: list[Truth] = []
        loops: list[Loop] = []
        for one in news:
            match one.message:
                case SeenTick() as tick:
                    ticks.setdefault(one.who, []).append(tick)
                case SeenHost() as host:
                    hosts.setdefault(one.who, []).append(host)
                case Truth() as truth:
                    truths.append(truth)
                case Loop() as loop:
                    loops.append(loop)
            self.now = max(self.now, one.t)
        self._world(ticks, truths)  # first what is looked at first
        for name, flown in ticks.items():
            if name in self._trails:
                self._ticks(self._names.index(name), name, flown)
        self._links(hosts, ticks)
        self._wires.draw(news)
        if loops:
            self._column("plot/loop/late", [o.t for o in loops], [1e3 * o.late_s for o in loops])
            self._column("plot/loop/busy", [o.t for o in loops], [1e3 * o.busy_s for o in loops])
        if news:
            obstacles(self._rec, self._scenario, self.now)
            self._aims_of.draw(ticks, self.now)
            self._banner()

    def _column(self, path: str, t: Sequence[float], values: Sequence[float]) -> None:
        self._rec.send_columns(
            path, [rr.TimeColumn("t", duration=t)], rr.Scalars.columns(scalars=values)
        )

    def _ticks(self, k: int, name: str, flown: list[SeenTick]) -> None:
        """Everything that one vehicle's ticks say."""
        setup, t = self._scenario.vehicles[name], [tick.inputs.t for tick in flown]
        period = self._scenario.flight.jet_period_s
        outs = [tick.outputs for tick in flown]
        for path, wrenches in (
            (f"plot/force/{name}", [o.wanted for o in outs]),
            (f"plot/force/{name}_delivered", [o.planned for o in outs]),
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
        self._jets(name, flown, period)
        self._valves(name, flown, setup.model.command_delay_s)
        words = [(self._last[name], 1)] if name in self._last else []
        before = [tick for tick, _ in words]
        for when, said in events([*before, *flown])[len(events(before)) :]:
            bad = when > 0.0 and said.startswith(TROUBLE)
            self._rec.set_time("t", duration=when)
            self._rec.log(
                "event",
                rr.TextLog(
                    plain(f"{when:6.1f}   {name}   {said}"), level="WARN" if bad else "INFO"
                ),
            )
        self._last[name] = flown[-1]

    def _mean(self, path: str, forces: list[tuple[float, float]], period: float) -> list[float]:
        """Size of a force, averaged over the last MEAN_S or so."""
        weight = min(1.0, period / MEAN_S)
        x, y = self._means.get(path, forces[0])
        out = []
        for fx, fy in forces:
            x, y = x + weight * (fx - x), y + weight * (fy - y)
            out.append(math.hypot(x, y))
        self._means[path] = (x, y)
        return out

    def _clearances(self, name: str, seen: list[tuple[float, State]]) -> None:
        rocks = list(self._scenario.obstacles.values())
        if not rocks:
            return
        gaps = [
            min(
                math.hypot(
                    s.pose.x - r.position[0] - t * r.velocity[0],
                    s.pose.y - r.position[1] - t * r.velocity[1],
                )
                - r.radius
                for r in rocks
            )
            for t, s in seen
        ]
        self._column(f"plot/clearance/{name}", [t for t, _ in seen], gaps)
        self._column("plot/clearance/limit", [t for t, _ in seen], [0.0] * len(seen))

    def _jets(self, name: str, flown: list[SeenTick], period: float) -> None:
        """Plumes, as long as the jet is open in the period."""
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
        first = self._names.index(name) * (m + 1)
        for jet in range(m):  # rows from the top: the first vehicle's first jet
            row = -float(first + jet) + 0.85 * np.minimum(share[:, jet], 1.0)
            self._column(f"plot/valve/{name}_{jet + 1}", times, row.tolist())
        if f"{name} jets" not in self._places:
            self._places[f"{name} jets"] = (0.0, 0.0)
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

    def _valves(self, name: str, flown: list[SeenTick], delay: float) -> None:
        """When each valve opened and shut."""
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

    def _world(self, ticks: dict[str, list[SeenTick]], truths: list[Truth]) -> None:
        """Poses: the truth where anybody knows it, else the estimate."""
        for k, name in enumerate(self._names):
            rows: list[tuple[float, float, float, float]] = []
            if truths:
                motions: list[tuple[float, Motion | None]] = [
                    (one.t, one.vehicles.get(name)) for one in truths
                ]
                rows = [(t, m.x, m.y, m.theta) for t, m in motions if m is not None]
            if not rows:
                for tick in ticks.get(name, ()):
                    if (s := tick.outputs.state) is not None:
                        rows.append((tick.inputs.t, s.pose.x, s.pose.y, s.pose.theta))
            if rows:
                self._pose(k, name, np.array(rows))
            self._aims(k, name, ticks.get(name, []))

    def _pose(self, k: int, name: str, rows: Array) -> None:
        t = rows[:, 0]
        zeros = np.zeros(len(t))
        turn = np.stack([zeros, zeros, np.sin(rows[:, 3] / 2), np.cos(rows[:, 3] / 2)], axis=1)
        place = np.stack([rows[:, 1], rows[:, 2], zeros], axis=1)
        self._rec.send_columns(
            f"world/vehicle/{name}",
            [rr.TimeColumn("t", duration=t)],
            rr.Transform3D.columns(translation=place, quaternion=turn),
        )
        radius = self._scenario.vehicles[name].model.radius
        label = place + np.array([0.0, radius + 0.17, LAYER["top"]])
        self._rec.send_columns(
            f"world/name/{name}",
            [rr.TimeColumn("t", duration=t)],
            [
                *rr.Points3D.columns(
                    positions=label,
                    labels=[plain(name)] * len(t),
                    colors=[hue(k)] * len(t),
                    radii=[0.001] * len(t),
                )
            ],
        )
        trail = self._trails[name]
        trail += [(x, y, LAYER["trail"]) for x, y in rows[:, 1:3].tolist()]
        step = max(1, len(trail) // TRAIL)
        self._rec.set_time("t", duration=float(t[-1]))
        self._rec.log(
            f"world/trail/{name}",
            rr.LineStrips3D([[*trail[::step], trail[-1]]], colors=[[*hue(k), 190]], radii=0.009),
        )
        self._places[name] = (float(rows[-1, 1]), float(rows[-1, 2]))

    def _aims(self, k: int, name: str, flown: list[SeenTick]) -> None:
        """Reference and stopping point of the newest tick."""
        if not flown or (state := flown[-1].outputs.state) is None:
            return
        z = LAYER["top"]
        self._rec.set_time("t", duration=flown[-1].inputs.t)
        if (pose := pose_of(flown[-1].outputs.flown)) is not None:
            self._rec.log(
                f"world/reference/{name}",
                rr.LineStrips3D([circle(pose.x, pose.y, 0.035, z)], colors=[WHITE], radii=0.006),
            )
        x, y = stopping_point(state, self._scenario.flight.tracker.brake_decel)
        size = 0.04
        lines = [
            [[state.pose.x, state.pose.y, z], [x, y, z]],
            [[x - size, y - size, z], [x + size, y + size, z]],
            [[x - size, y + size, z], [x + size, y - size, z]],
        ]
        if math.hypot(x - state.pose.x, y - state.pose.y) < size:
            lines = []  # it stops where it is: the cross would only hide the vehicle
        self._rec.log(
            f"world/stop/{name}", rr.LineStrips3D(lines, colors=[RED] * len(lines), radii=0.006)
        )

    def _links(self, hosts: dict[str, list[SeenHost]], ticks: dict[str, list[SeenTick]]) -> None:
        """Who hears whom, with distances, and how old what the host has heard is."""
        pairs = set()
        for name, told in hosts.items():
            rows = [(h.inputs.t, h.inputs.own) for h in told if h.inputs.own is not None]
            ages = [(t, 1e3 * (t - own.t)) for t, own in rows]
            if ages:
                self._column(f"plot/link/{name}", [t for t, _ in ages], [a for _, a in ages])
                lost = self._lost(name, [(t, own.t) for t, own in rows])
                self._column(f"plot/loss/{name}", [t for t, _ in ages], lost)
            pairs |= {tuple(sorted((name, other))) for other in told[-1].inputs.neighbours}
        for name, flown in ticks.items():
            pairs |= {tuple(sorted((name, o))) for o in flown[-1].inputs.neighbours}
        reach, lines, labels, colours = range_of(self._scenario), [], [], []
        for a, b in sorted(pairs):
            if a not in self._places or b not in self._places:
                continue
            (ax, ay), (bx, by) = self._places[a], self._places[b]
            gap = math.hypot(bx - ax, by - ay)
            lines.append([[ax, ay, LAYER["link"]], [bx, by, LAYER["link"]]])
            far = reach is not None and gap > reach and self._aims_of.matters(a, b)
            colours.append((*RED, 255) if far else (120, 130, 145, 130))
            said = reach is not None and self._aims_of.matters(a, b)
            labels.append(f"{gap:.2f} of {reach:g} m" if said else "")
        if lines:
            self._rec.set_time("t", duration=self.now)
            self._rec.log(
                "world/link",
                rr.LineStrips3D(
                    lines, colors=colours, radii=0.005, labels=labels, show_labels=reach is not None
                ),
            )

    def _lost(self, name: str, heard: list[tuple[float, float]]) -> list[float]:
        """Share of ticks without anything new, over some seconds [%]."""
        share, newest = self._renewed.get(name, (0.0, -1.0))
        out = []
        for _, stamp in heard:
            share += 0.02 * ((0.0 if stamp > newest else 100.0) - share)
            newest = stamp
            out.append(share)
        self._renewed[name] = (share, newest)
        return out

    def _banner(self) -> None:
        """Everybody's state in words."""
        over = self._wires.phase in ("DISARMED", "STOPPED", "FAULT")
        states = {}
        for name in self._names:
            tick = self._last.get(name)
            if tick is None:
                words = "silent"
            elif tick.outputs.fault:
                words = f"**FAULT: {tick.outputs.fault}**"
            elif tick.outputs.inhibit_reason:
                words = f"waits: {tick.outputs.inhibit_reason}"
            else:
                words = "flown" if over else "flies"
                words += ", filter intervenes" * (tick.outputs.filtered is not None)
            states[name] = words
        head = f"### {self._scenario.name}, law {law_of(self._scenario)}   |   "
        if self._wires.phase:
            head += f"{self._wires.phase}   |   "
        said = plain(head + "   |   ".join(grouped(states)))
        if said != self._said:
            self._said = said
            self._rec.set_time("t", duration=self.now)
            self._rec.log("banner", rr.TextDocument(said, media_type="text/markdown"))
