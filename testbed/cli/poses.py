"""`testbed poses`: the poses that motion capture measures, in the table's frame.

Use it to set up a table: move a vehicle along the table's x axis and x must grow; turn it
counter-clockwise and the heading must grow. It sends no commands and needs no host.
"""

from collections import deque
from collections.abc import Iterable, Mapping, Sequence
from contextlib import ExitStack, suppress
from math import degrees
from pathlib import Path

from rich.console import Console
from rich.live import Live
from rich.table import Table as Grid

from testbed.cli.exit_code import FAILED, OK
from testbed.cli.refusal import errors, refuse
from testbed.cli.screen import print_text
from testbed.config import ConfigError, Experiment, find, load
from testbed.core.error import TestbedError
from testbed.core.lab import MocapWire
from testbed.core.types import Pose
from testbed.mocap.exposure import Axes, Exposure, MocapSource
from testbed.mocap.source import datagrams, make_source
from testbed.net.access import open_lab
from testbed.net.keys import Keys
from testbed.net.session import NetworkError, NoHostError, dial
from testbed.realtime.wall_clock import monotonic_ns, sleep_until_ns

LOOK_NS = 100_000_000  # period of polling the sockets and of redrawing
SECOND_NS = 1_000_000_000
HOST_S = 0.5  # timeout for the host's answer, if poses come through it


class Seen:
    """One body: its newest pose, and the frames of the last second."""

    def __init__(self) -> None:
        self.pose: Pose | None = None
        self.latency_ms = 0.0  # exposure to arrival
        self.arrived_ns: deque[int] = deque()  # frames of the last second that track the body

    def rate(self, now_ns: int) -> int:
        """Frames of the last second that track the body [Hz]."""
        while self.arrived_ns and self.arrived_ns[0] <= now_ns - SECOND_NS:
            self.arrived_ns.popleft()
        return len(self.arrived_ns)


class Room:
    """All bodies that motion capture reports, by their motion-capture names."""

    def __init__(self, wire: MocapWire, vehicles: Iterable[str]) -> None:
        self._axes = Axes(wire)
        self.bodies = {name: wire.bodies.get(name, name) for name in vehicles}
        self.seen: dict[str, Seen] = {}

    def take(self, exposures: Sequence[Exposure]) -> None:
        """Store new exposures for rates and latencies."""
        for exposure in exposures:
            for body, sighting in exposure.bodies.items():
                one = self.seen.setdefault(body, Seen())
                if sighting.tracked:
                    one.pose = self._axes.to_table(sighting)
                    one.latency_ms = 1e-6 * (exposure.arrived_ns - exposure.exposed_ns)
                    one.arrived_ns.append(exposure.arrived_ns)

    def picture(self, now_ns: int) -> Grid:
        """The table, one row per body."""
        vehicle_of = {body: name for name, body in self.bodies.items()}
        grid = Grid(box=None, pad_edge=False, padding=(0, 2, 0, 0))
        for heading in ("body", "vehicle"):
            grid.add_column(heading, overflow="fold")
        for heading in ("x [m]", "y [m]", "heading [deg]", "rate [Hz]", "latency [ms]"):
            grid.add_column(heading.replace("[", "\\["), justify="right", no_wrap=True)
        for body, one in sorted(self.seen.items()):
            cells = ("-", "-", "-")
            if one.pose is not None:
                pose = one.pose
                cells = (f"{pose.x:z.3f}", f"{pose.y:z.3f}", f"{degrees(pose.theta):z.1f}")
            rate, name = one.rate(now_ns), vehicle_of.get(body, "-")
            grid.add_row(body, name, *cells, str(rate), f"{one.latency_ms:.1f}")
        return grid

    def missing(self) -> Mapping[str, str]:
        """Vehicles whose body was never tracked, with the body's name."""
        tracked = {body for body, one in self.seen.items() if one.pose is not None}
        return {name: body for name, body in self.bodies.items() if body not in tracked}


def cameras(experiment: Experiment, stack: ExitStack) -> MocapSource:
    """Connect to motion capture; over Zenoh through the host, or in its place if no host runs.

    Raises:
        OSError, NetworkError: the connection failed.
    """
    lab = experiment.table.lab
    if lab.mocap.system != "zenoh":
        return datagrams(lab.mocap)
    network = lab.network
    try:
        session = dial(network.endpoint, HOST_S, Path(network.keys) if network.keys else None)
    except NoHostError:
        session, _ = open_lab(network, experiment.vehicles)
    stack.enter_context(session)
    return make_source(lab.mocap, session, Keys(network.lab))


def where(experiment: Experiment) -> tuple[str, str]:
    """The sender of the poses, and the address where they should arrive."""
    lab = experiment.table.lab
    if lab.mocap.system == "zenoh":
        return f"zenoh on {Keys(lab.network.lab).pose}", lab.network.endpoint
    return f"{lab.mocap.system} at {lab.mocap.server}", lab.mocap.interface


def watch_poses(name: str, overrides: Sequence[str], seconds: float | None) -> int:
    """Show poses until Ctrl-C, or for some seconds; 1 if a vehicle was never tracked."""
    out = Console(highlight=False)
    with ExitStack() as stack:
        try:
            experiment = load(find(name), overrides)
            source = cameras(experiment, stack)
        except (ConfigError, NetworkError, OSError) as error:
            return refuse(error)
        stack.callback(source.close)
        room = Room(experiment.table.lab.mocap, experiment.vehicles)
        end = None if seconds is None else monotonic_ns() + round(1e9 * seconds)
        live, looked = None, monotonic_ns()
        if out.is_terminal:
            live = stack.enter_context(Live(console=out, transient=True, auto_refresh=False))
        with suppress(KeyboardInterrupt):
            while end is None or monotonic_ns() < end:
                room.take(source.poll())
                looked = monotonic_ns()
                if live is not None:
                    live.update(room.picture(looked), refresh=True)
                sleep_until_ns(monotonic_ns() + LOOK_NS)
    if not room.seen:
        sender, address = where(experiment)
        found = getattr(source, "complaint", "")  # not every system can tell
        found = found or "no poses: check that it streams to this address and passes the firewall"
        expected = f"poses that arrive at {address}"
        return refuse(TestbedError(where=sender, expected=expected, found=found), FAILED)
    out.print(room.picture(looked))  # as of the last poll
    for vehicle, body in room.missing().items():
        print_text(
            errors,
            f"{vehicle}: the cameras do not track {body!r}; [lab.mocap] bodies maps its name",
            "red",
        )
    return FAILED if room.missing() else OK
