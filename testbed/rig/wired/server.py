"""The twin as a server in real time: it replaces the cameras, boards and plant of a lab.

It serves a NatNet stream, a serial port per vehicle with the real firmware behind it, and the
truth on the network. One loop in one thread forwards bytes as they arrive, and advances the plant
to the camera's next exposure when its frame is due. By then, one camera latency after the exposure,
the firmware has reported its valve edges.

A vehicle rests on the granite until its board turns bearing air on; the plant starts when all
boards have done so.
"""

import select
from collections.abc import Callable
from contextlib import ExitStack, suppress
from pathlib import Path

import msgspec
import numpy as np
from msgspec.structs import replace

from firmware_interface.limits import limits_of
from firmware_interface.line_tap import LineTap
from firmware_interface.messages import Status
from sim_twin.camera import Cameras
from sim_twin.fault_injection import FaultInjector
from sim_twin.plant import Plant
from sim_twin.randomness import stream
from sim_twin.reference_bodies import ReferenceBodies
from sim_twin.reported import ReportedValves
from testbed.config import Experiment
from testbed.core.fault_injection import Injection
from testbed.core.types import Pose, PoseSample
from testbed.mocap.exposure import Axes, Sighting
from testbed.mocap.natnet import Described, MocapFrame, RigidBody
from testbed.mocap.natnet_server import NatNetAddress, NatNetServer
from testbed.mocap.topic import encode_poses
from testbed.net.credentials import neighbour
from testbed.net.envelope import head_of
from testbed.net.keys import Keys
from testbed.net.session import NetworkError, Publisher, Subscriber, dial
from testbed.realtime.wall_clock import monotonic_ns
from testbed.rig.wired.process_faults import OF_PROCESSES
from testbed.rig.wired.table_report import TableReport
from testbed.rig.wired.true_course import TrueCourse

SENSE_NS = 100_000_000  # between two gauge readings of the boards
TRUTH_FRAMES = 5  # exposures between two messages of the truth
DIAL_NS = 1_000_000_000  # between two attempts to reach the host
QUIET_NS = 500_000_000  # a serial line without traffic for this long is unused
LARGEST_S = 1e6  # largest time stamp of a lease
ERROR_M = 0.0002  # error of the marker fit that a healthy system reports
UNTRACKED = Sighting((0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0), tracked=False)


class TableServer:
    """The table with its cameras and boards; a context manager. `run` serves until told to end.

    Args:
        experiment: its `table.lab` has the addresses to serve.
        folder: for the vehicles' serial ports; None: as in the lab file, else the current folder.
    """

    def __init__(self, experiment: Experiment, folder: Path | None) -> None:
        self.experiment, self._folder = experiment, folder
        setups, table = experiment.vehicles, experiment.table
        self.names = list(setups)
        self.models = {name: setup.model for name, setup in setups.items()}
        starts = {name: Pose(*setup.start) for name, setup in setups.items()}
        seed = experiment.seed
        self.plant = Plant(self.models, starts, table, experiment.obstacles, seed)
        self._cameras = Cameras(self.names, table.mocap, seed, table.spread)
        self._fixed = ReferenceBodies(table.lab.mocap.reference, table.mocap, seed)
        self._bodies = [*self.names, *table.lab.mocap.reference]
        self._jitter = stream(seed, "frames")
        self._valves = {
            n: ReportedValves(m, self.plant.boards[n].pulses, stream(seed, n, "pulses"))
            for n, m in self.models.items()
        }
        self._axes, self._keys = Axes(table.lab.mocap), Keys(table.lab.network.lab)
        self._truth: Publisher | None = None
        self._released_ns: int | None = None
        self._course = TrueCourse(self.plant, self._valves)
        self._edges: dict[str, list[tuple[int, int]]] = {name: [] for name in self.names}
        self._pose_topic: Publisher | None = None
        self._leases: Subscriber | None = None  # their stamps give the run's time 0
        # faults from the start are there before the arming checks
        self._injector = self._inject([one for one in self._injections() if one.at_s == 0.0])
        self._planned = False
        self._cut: dict[str, LineTap] = {}  # lines that an injected fault has cut
        self._down: set[str] = set()  # boards without power
        self._landed: set[str] = set()  # vehicles whose air is off until the end
        limits = [limits_of(model) for model in self.models.values()]
        self._landing_ns = 1000 * max(one.land_after_us for one in limits)

    def __enter__(self) -> "TableServer":
        with ExitStack() as stack:
            # first: a second twin with the same file fails here, before it takes any port
            wire = self.experiment.table.lab.mocap
            major, minor = wire.version.split(".")
            self._mocap = stack.enter_context(
                NatNetServer(
                    NatNetAddress(wire.server, wire.command_port, wire.data_port, wire.group),
                    (int(major), int(minor)),
                    [Described(k + 1, wire.bodies.get(n, n)) for k, n in enumerate(self._bodies)],
                )
            )
            self._taps = {}
            for k, name in enumerate(self.names):
                link = pty_path(self.experiment, name, self._folder)
                limits = limits_of(self.models[name])
                chip = self.experiment.board == "qemu"
                self._taps[name] = stack.enter_context(LineTap(limits, 1 + k, link, chip=chip))
            self._stack = stack.pop_all()
        return self

    def __exit__(self, *error: object) -> None:
        self._stack.close()

    @property
    def pids(self) -> dict[str, int]:
        """Process ids of the firmware, by vehicle."""
        return {name: tap.pid for name, tap in self._taps.items()}

    # Time

    def run(self, ended: Callable[[], bool]) -> None:
        """Serve until `ended()`, checked at every frame, and until no serial line is in use."""
        mocap = self.experiment.table.mocap
        period, latency = 1e9 / mocap.rate_hz, round(1e9 * mocap.latency_s)
        began = monotonic_ns()
        frame, sense_due, dial_due, asked_at = 0, began, began, 0
        taps = self._taps.values()
        for tap in taps:
            tap.listen()
        fds = self._fds()
        while True:
            exposed = began + round(frame * period)
            due = exposed + latency + self._late_by()
            while (left := due - monotonic_ns()) > 0:
                select.select(fds, [], [], 1e-9 * left)
                self._serve()
                self._follow()
            self._expose(frame, exposed)
            self._rehearse()
            frame += 1
            now = monotonic_ns()
            if now >= sense_due:
                sense_due = now + SENSE_NS
                self._sense()
            if self._truth is None and now >= dial_due:
                dial_due = now + DIAL_NS
                self._dial()
            if asked_at == 0 and ended():
                asked_at = now
            quiet = QUIET_NS + (self._landing_ns if any(t.bearing for t in taps) else 0)
            if asked_at and now - self._spoken_ns() > quiet and now - asked_at > quiet:
                return

    def _late_by(self) -> int:
        mocap = self.experiment.table.mocap
        jitter = mocap.jitter_s * float(self._jitter.standard_normal())
        return round(1e9 * max(jitter, -0.5 * mocap.latency_s))

    def _fds(self) -> list[int]:
        lines = [fd for tap in self._taps.values() for fd in tap.fds]
        return [*lines, self._mocap.socket.fileno()]

    def _spoken_ns(self) -> int:
        return max(1000 * tap.spoken_us for tap in self._taps.values())

    # The lines

    def cut_next(self) -> None:
        """Cut the serial line of the next vehicle, to simulate a broken cable."""
        for tap in self._taps.values():
            if not tap.cut:
                tap.cut = True
                return

    def _serve(self) -> None:
        for tap in self._taps.values():
            tap.serve()
        self._mocap.serve()

    def _follow(self) -> None:
        """Apply the boards' reports to the plant; start it when all vehicles float."""
        for name, tap in self._taps.items():
            for at_us, mask in tap.edges():
                self._edges[name].append((at_us, mask))
                if self._released_ns is not None:
                    at = 1000 * at_us - self._released_ns
                    self._valves[name].edge(at, mask, self.plant.t)
        if self._released_ns is not None:
            for k, (name, tap) in enumerate(self._taps.items()):
                if not tap.bearing and name not in self._landed:
                    self._landed.add(name)
                    self.plant.land(self.plant.vehicle_of_board(k))
                elif tap.bearing and name in self._landed - self._down:
                    self._landed.discard(name)
                    self.plant.lift(self.plant.vehicle_of_board(k))
        elif all(tap.bearing for tap in self._taps.values()):
            self._released_ns = monotonic_ns()

    def _sense(self) -> None:
        for k, name in enumerate(self.names):
            air = self.models[name].air
            pressure = air.supply_pressure(air.gas - float(self.plant.used[k]))
            battery = self.models[name].gauges.battery_v
            pressure = self._injector.supply(name, pressure)
            if flat := self._injector.found(name, "flat_battery"):
                battery = flat.size
            self._taps[name].sense(round(1e3 * battery), round(pressure))

    # The cameras

    def _expose(self, number: int, exposed: int) -> None:
        """Send the frame that was exposed one latency ago."""
        self._follow()
        bodies = self._bodies_seen(exposed, self._advance(exposed))
        now = monotonic_ns()
        if self.experiment.table.lab.mocap.system == "zenoh":
            self._say_poses(number, exposed, bodies)
        else:
            self._mocap.send(MocapFrame(number, tuple(bodies), 1e-9 * exposed, exposed, now, now))
        if number % TRUTH_FRAMES == 0:
            self._publish_truth(exposed)

    def _advance(self, exposed: int) -> float | None:
        """Move the plant on to an exposure; its time [s], None before the vehicles float."""
        if self._released_ns is None:
            return None
        t = 1e-9 * (exposed - self._released_ns)
        if t > self.plant.t:
            self._injector.before(t)
            self.plant.advance(t)
            self._injector.look(t)
            self._course.note(t)
        return t

    def _bodies_seen(self, exposed: int, t: float | None) -> list[RigidBody]:
        """All bodies of the frame, with errors of the cameras and injected faults."""
        rows = None if t is None else self._injector.sources(self.names, np.array([t]))
        shown = None if rows is None else np.array(rows, np.int64)
        self._cameras.expose(np.array([1e-9 * exposed]), self.plant.x[None], np.inf, shown)
        fixed = self._fixed.seen(self.plant.t, self._injector)
        bodies = []
        for k, name in enumerate(self._bodies):
            seen = self._look(name, k) if k < len(self.names) else self._shown(fixed.get(name))
            bodies.append(
                RigidBody(k + 1, seen.position, seen.rotation, ERROR_M, tracked=seen.tracked)
            )
        return bodies

    def _say_poses(self, number: int, exposed: int, bodies: list[RigidBody]) -> None:
        """Publish the frame over Zenoh, for a lab whose cameras do so."""
        if self._pose_topic is None:
            return
        wire = self.experiment.table.lab.mocap
        seen = {
            wire.bodies.get(name, name): (*body.position, *body.rotation)
            for name, body in zip(self._bodies, bodies, strict=True)
            if body.tracked
        }
        self._pose_topic.send(encode_poses(number, exposed, monotonic_ns(), seen))

    def _look(self, name: str, k: int) -> Sighting:
        now = self.plant.t  # injections use the plant's time here: 0 until the vehicles float
        fresh = [PoseSample(now, one.x, one.y, one.theta) for one in self._cameras.arrived(k)]
        samples = self._injector.poses(name, fresh)
        return self._shown(samples[-1] if samples else None)

    def _shown(self, one: PoseSample | None) -> Sighting:
        return UNTRACKED if one is None else self._axes.to_cameras(Pose(one.x, one.y, one.theta))

    # The network

    def _dial(self) -> None:
        with suppress(NetworkError):
            network = self.experiment.table.lab.network
            keys = neighbour(Path(network.keys), "table", "") if network.keys else None
            self._session = dial(network.endpoint, 0.0, keys)
            self._stack.callback(self._session.close)
            self._truth = Publisher(self._session, self._keys.truth, bulk=True)
            self._pose_topic = Publisher(self._session, self._keys.pose)
            self._leases = Subscriber(self._session, self._keys.lease)

    def _publish_truth(self, exposed: int) -> None:
        if self._truth is not None:
            poses = dict(zip(self.names, self.plant.x.tolist(), strict=True))
            self._truth.send(msgspec.msgpack.encode((exposed, poses)))

    # Rehearsed faults

    def _rehearse(self) -> None:
        """Inject the faults that are due; their times are converted to the plant's time."""
        if not self._planned:
            self._plan_injections()
        injector = self._injector
        for name, tap in self._taps.items():
            cut = injector.found(name, "cut_serial")
            if cut:
                tap.cut = True
                self._cut[name] = tap
            elif self._cut.pop(name, None):
                tap.cut = False
            dead = tap.dead or injector.found(name, "brown_out") is not None
            if dead != (name in self._down):
                self._power(name, tap, off=dead)

    def _plan_injections(self) -> None:
        """Schedule the injections as soon as the run's time 0 is known."""
        if self._leases is None or self._released_ns is None or not self.experiment.inject:
            return
        for at, data in self._leases.received():
            head = head_of(data)
            if head is None or not abs(head.issued_at) < LARGEST_S:
                continue  # not from the host
            later = 1e-9 * (at - self._released_ns) - head.issued_at
            shifted = [
                replace(one, at_s=max(0.0, one.at_s + later)) if one.at_s else one
                for one in self._injections()
            ]
            self._injector, self._planned = self._inject(shifted), True
            return

    def _injections(self) -> list[Injection]:
        """The faults that are injected here, not in the vehicles' processes or the host's."""
        return [one for one in self.experiment.inject if one.kind not in OF_PROCESSES]

    def _inject(self, injections: list[Injection]) -> FaultInjector:
        size, obstacles = self.experiment.table.size, self.experiment.obstacles
        half, seed = (size[0] / 2, size[1] / 2), self.experiment.seed
        return FaultInjector(injections, self.plant, obstacles, half, seed, boards=False)

    def _power(self, name: str, tap: LineTap, *, off: bool) -> None:
        """Switch a board's power off or on."""
        tap.power(on=not off)
        if off:
            self._down.add(name)
            self._edges[name].append((monotonic_ns() // 1000, 0))
            if self._released_ns is not None:
                self._valves[name].close_all(monotonic_ns() - self._released_ns)
                self._landed.add(name)  # the bearing valve is normally closed, too
                self.plant.land(self.names.index(name))
        else:
            self._down.discard(name)

    # The end

    def report(self) -> TableReport:
        """The true course of the flight so far."""
        plant, flown = self.plant, (self.plant.impulse.copy(), self.plant.used.copy())
        later_t, later = list[float](), list[list[list[float]]]()
        if self._released_ns is not None:
            later_t, later = self._course.minute_after(self._injector)

        def by_name(values: object) -> dict[str, float]:
            return dict(zip(self.names, np.asarray(values).tolist(), strict=True))

        return TableReport(
            released_ns=self._released_ns,
            t=self._course.t,
            states=self._course.states,
            touches=plant.touches,
            impulse=by_name(flown[0]),
            gas=by_name(flown[1]),
            openings={n: v.openings for n, v in self._valves.items()},
            late_edges={n: v.late for n, v in self._valves.items()},
            edges=self._edges,
            boards=[tap.board_name for tap in self._taps.values()],
            left_as={name: _left_as(tap.status) for name, tap in self._taps.items()},
            silence_ms={name: 1e-3 * tap.silence_us for name, tap in self._taps.items()},
            spent=self._course.spent,
            later_t=later_t,
            later_states=later,
            floats={name: plant.floats(k) for k, name in enumerate(self.names)},
        )


def _left_as(status: Status | None) -> tuple[str, list[str]]:
    if status is None:
        return "silent", []
    return status.state.name, [fault.name or "" for fault in status.faults]


def pty_path(experiment: Experiment, name: str, folder: Path | None) -> Path:
    """Where a simulated board's serial port appears: in `folder`, else at the lab's path."""
    here = f"serial-{name}"
    if folder is not None:
        return folder / here
    return Path(experiment.table.lab.serial.ports.get(name, here))
