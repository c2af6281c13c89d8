"""The dashboard's table from above, its headline and its events, drawn frame by frame."""

import math
from collections.abc import Mapping

from testbed.config.experiment import Experiment
from testbed.core.codes import Response
from testbed.core.types import HostTick, Tick
from testbed.dashboard.banner import AMBER, GREEN, GREY, Banner, picture
from testbed.dashboard.banner import RED as ALARM
from testbed.dashboard.columns import ColumnBuffer, Label, Lines
from testbed.dashboard.frame import FRAME_S, Frame
from testbed.dashboard.scene_goals import AimScene
from testbed.dashboard.static_scene import (
    FAULTY,
    LAYER,
    RED,
    TRAIL,
    circle,
    hue,
    is_moving,
    plain,
)
from testbed.dashboard.static_scene import (
    GREY as LINK,
)
from testbed.logs.feed import SeenPace, SeenPhase, pose_of, stopping_point
from testbed.logs.history import FlightEvent, camera_events, events, phase_change
from testbed.logs.truth import Truth
from testbed.report.fault_story import OVER, SUPERVISOR, FaultyVehicles, Story
from testbed.report.law import law_of, range_of

STALE_S = 1.0  # links of a vehicle are not drawn from messages older than this
TRAIL_S = 0.5  # between two updates of a trail, which is redrawn completely
CROSS = 0.04  # [m] size of a stopping point

Place = tuple[float, float, float]  # x, y [m], theta [rad]


def grouped(states: Mapping[str, str]) -> list[str]:
    """Names of vehicles grouped by state, so that a banner is one line."""
    names: dict[str, list[str]] = {}
    for name, words in states.items():
        names.setdefault(words, []).append(name)
    return [f"{', '.join(who)} {words}" for words, who in names.items()]


class TableScene:
    """Draws the table, the headline and the events of one run."""

    def __init__(self, scenario: Experiment, columns: ColumnBuffer) -> None:
        self._scenario, self._columns = scenario, columns
        self._names = list(scenario.vehicles)
        self._newest: dict[str, Tick] = {}
        self._heard: dict[str, HostTick] = {}
        self._places: dict[str, Place] = {}
        self._trails: dict[str, list[tuple[float, float, float]]] = {n: [] for n in self._names}
        self._trail_due = 0.0  # [s]
        self._cameras: dict[str, str] = {}
        self._phase = SeenPhase(0.0, "")  # of the supervisor
        self._trouble, self._story = FaultyVehicles(scenario), Story(scenario)
        self._aims = AimScene(scenario, columns)
        self._banner = Banner("", GREY)
        self._culprits: dict[str, str] = {}
        self._linked = False
        for k, name in enumerate(self._names):
            columns.add("colour", f"world/vehicle/{name}/body", 0.0, (*hue(k), 255))

    def draw(self, frame: Frame) -> None:
        """Draw vehicles, jets, goals and references at the newest time."""
        t = frame.t
        ticks, truths, news = self._take(frame)
        self._trouble.see(self._newest)
        self._mark(t)
        for k, name in enumerate(self._names):
            self._poses(k, name, ticks.get(name, []), truths)
            if name in self._newest:
                self._aim(name, t)
        if t >= self._trail_due:
            self._trail_due = (math.floor(t / TRAIL_S + 1e-6) + 1) * TRAIL_S - 1e-6
            self._draw_trails(t)
        self._links(t)
        for name, obstacle in self._scenario.obstacles.items():
            if is_moving(obstacle):
                x, y = (
                    p + t * v for p, v in zip(obstacle.position, obstacle.velocity, strict=True)
                )
                self._columns.add("transform", f"world/obstacle/{name}", t, (x, y, 0.0))
        self._aims.draw(self._newest, t)
        for one in self._story.lines_of(news):
            who = ", ".join(one.who) + "   " * (one.who != (SUPERVISOR,))
            who = "" if one.who == (SUPERVISOR,) else who
            words = plain(f"{one.t:6.1f}   {who}{one.words}")
            self._columns.add("event", "event", one.t, (words, one.level))
        banner = self._headline()
        if banner != self._banner:
            self._banner = banner
            self._columns.add("picture", "banner", t, picture(banner))

    def _take(
        self, frame: Frame
    ) -> tuple[dict[str, list[Tick]], list[Truth], list[tuple[str, FlightEvent]]]:
        """Ticks by vehicle, truths and events of a frame; stores the newest of each."""
        ticks: dict[str, list[Tick]] = {}
        truths: list[Truth] = []
        news: list[tuple[str, FlightEvent]] = []
        for _, who, t, message in frame.news:
            match message:
                case Tick() if who in self._trails:
                    ticks.setdefault(who, []).append(message)
                case HostTick():
                    self._heard[who] = message
                case Truth():
                    truths.append(message)
                case SeenPhase():
                    self._phase = message
                    news.append((SUPERVISOR, phase_change(message)))
                case SeenPace(cameras=cameras):
                    before = self._cameras.get(who, "")
                    news += [(who, one) for one in camera_events([(t, message)], before)]
                    self._cameras[who] = cameras
        for name, flown in ticks.items():
            known = [self._newest[name]] if name in self._newest else []
            news += [(name, one) for one in events([*known, *flown])[len(events(known)) :]]
            self._newest[name] = flown[-1]
        return ticks, truths, news

    # Vehicles

    def _mark(self, t: float) -> None:
        """Mark vehicles with a fault of their own red, with a cross."""
        culprits = self._trouble.culprits(self._newest)
        for k, name in enumerate(self._names):
            faulty = name in culprits
            if faulty == (name in self._culprits):
                continue
            radius, z = self._scenario.vehicles[name].model.radius, LAYER["cross"]
            a = 0.8 * radius
            cross = Lines([[[-a, -a, z], [a, a, z]], [[-a, a, z], [a, -a, z]]] if faulty else ())
            path = f"world/vehicle/{name}"
            self._columns.add("colour", f"{path}/body", t, (*(FAULTY if faulty else hue(k)), 255))
            self._columns.add("lines", f"{path}/cross", t, cross)
        self._culprits = culprits

    def _poses(self, k: int, name: str, flown: list[Tick], truths: list[Truth]) -> None:
        """Draw the true pose if the rig knows it, otherwise the estimate."""
        rows = [
            (one.t, m.x, m.y, m.theta) for one in truths if (m := one.vehicles.get(name))
        ] or [
            (tick.inputs.t, s.pose.x, s.pose.y, s.pose.theta)
            for tick in flown
            if (s := tick.outputs.state) is not None
        ]  # fmt: skip
        above = self._scenario.vehicles[name].model.radius + 0.17
        words, colour = plain(name), hue(k)
        if name in self._culprits:
            words, colour = f"{words} FAULT", FAULTY
        for t, x, y, theta in rows:
            self._columns.add("transform", f"world/vehicle/{name}", t, (x, y, theta))
            label = Label(x, y + above, LAYER["top"], words, colour)
            self._columns.add("label", f"world/name/{name}", t, label)
            self._trails[name].append((x, y, LAYER["trail"]))
            self._places[name] = (x, y, theta)

    def _draw_trails(self, t: float) -> None:
        for name, trail in self._trails.items():
            if trail:
                step = max(1, len(trail) // TRAIL)
                self._columns.add(
                    "lines", f"world/trail/{name}", t, Lines([[*trail[::step], trail[-1]]])
                )

    def _aim(self, name: str, t: float) -> None:
        """Draw reference and stopping point."""
        out, z = self._newest[name].outputs, LAYER["top"]
        asked, lines = pose_of(out.active_setpoint), []
        ring = [] if asked is None else [circle(asked.x, asked.y, 0.035, z)[::3]]
        self._columns.add("lines", f"world/reference/{name}", t, Lines(ring))
        if (state := out.state) is not None:
            x, y = stopping_point(state, self._scenario.flight.tracker.brake_decel)
            if math.hypot(x - state.pose.x, y - state.pose.y) >= CROSS:  # else it hides the vehicle
                lines = [
                    [[state.pose.x, state.pose.y, z], [x, y, z]],
                    [[x - CROSS, y - CROSS, z], [x + CROSS, y + CROSS, z]],
                    [[x - CROSS, y + CROSS, z], [x + CROSS, y - CROSS, z]],
                ]
        self._columns.add("lines", f"world/stop/{name}", t, Lines(lines))

    # Links

    def _links(self, t: float) -> None:
        """Draw the links between vehicles, with distances."""
        pairs = {
            tuple(sorted((name, other)))
            for states in (self._newest, self._heard)
            for name, one in states.items()
            if t - one.inputs.t <= max(STALE_S, FRAME_S)
            for other in one.inputs.neighbours
        }
        reach, z = range_of(self._scenario), LAYER["link"]
        lines, colours, labels = [], [], []
        for a, b in sorted(pairs):
            if a not in self._places or b not in self._places:
                continue
            (ax, ay, _), (bx, by, _) = self._places[a], self._places[b]
            gap = math.hypot(bx - ax, by - ay)
            lines.append([[ax, ay, z], [bx, by, z]])
            matters = reach is not None and self._aims.matters(a, b)
            far = matters and gap > (reach or 0.0)
            colours.append((*RED, 255) if far else (*LINK, 130))
            labels.append(f"{gap:.2f} of {reach:g} m" if matters else "")
        if lines or self._linked:
            self._columns.add("lines", "world/link", t, Lines(lines, colours, labels))
        self._linked = bool(lines)

    # Headline

    def _headline(self) -> Banner:
        """The state of all vehicles, or the fault with its origin first."""
        name, phase = self._scenario.name, self._phase.phase
        if fault := self._trouble.banner(self._newest):
            return Banner(plain(fault), ALARM)
        if phase == "FAULT":
            return Banner(plain(f"FAULT {phase_change(self._phase).words}"), ALARM)
        over, flies, states = phase in OVER, set[str](), dict[str, str]()
        for who in self._names:
            tick = self._newest.get(who)
            if tick is None:
                words = "silent"
            elif tick.outputs.inhibit_reason:
                words = f"waits: {tick.outputs.inhibit_reason.words}"
            elif tick.outputs.response >= Response.HOLD:
                words = tick.outputs.response.words
            else:
                flies.add(who)
                words = "in flight" + ", filter intervenes" * (tick.outputs.filtered is not None)
            states[who] = "flown" if over and tick is not None else words
        head = f"{phase}   |   " if phase else ""
        text = f"{head}{'   |   '.join(grouped(states))}   |   {name}, law {law_of(self._scenario)}"
        colour = GREEN if flies.issuperset(self._names) else AMBER
        return Banner(plain(text), GREY if over else colour)
