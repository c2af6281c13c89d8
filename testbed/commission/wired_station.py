"""Real cameras and valve boards as a station: of a lab, or of the twin behind real wires."""

from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack

from firmware_interface.serial_board import BoardError
from firmware_interface.serial_thrusters import ThrustersError
from testbed.commission.cameras import Mark
from testbed.commission.station import BoardFacts
from testbed.config import Experiment
from testbed.core.types import Health, PoseSample, ValveCommand
from testbed.mocap.exposure import Axes, MocapSource
from testbed.realtime.wall_clock import monotonic_ns, sleep_until_ns
from testbed.rig.wired.thrusters import WiredThrusters, make_thrusters

KEPT_S = 0.3  # from the end of a pulse to the end of its plan, before which the board is disarmed
LOOK_NS = 5_000_000  # between two looks while waiting
NO_HEALTH = Health(0.0, 0.0, 0.0, 0.0)


class WiredStation:
    """The boards of some vehicles, and the cameras; close it with the stack.

    Args:
        experiment: all vehicles, for the names of their bodies.
        names: vehicles whose boards are connected to this computer.
        source: the cameras.
        stack: closes boards and cameras.
        ask: asks the person at the table a question; None: there is none, as on the bench.
        agree: asks whether something may move; None: nothing is asked.
    """

    def __init__(
        self, experiment: Experiment, names: Sequence[str], source: MocapSource, stack: ExitStack,
        ask: Callable[[str], bool] | None, agree: Callable[[str], bool] | None,
    ) -> None:  # fmt: skip
        lab = experiment.table.lab
        self._experiment, self._source = experiment, source
        self._ask, self._agree = ask, agree
        self._axes, self._began_ns = Axes(lab.mocap), monotonic_ns()
        self._names = {lab.mocap.bodies.get(name, name): name for name in experiment.vehicles}
        self._boards: dict[str, WiredThrusters] = {}
        self._trouble: dict[str, str] = {}
        self._closing: dict[str, float] = {}  # boards to disarm, and when [s]
        self._heard: dict[str, int] = {}  # valves that the boards have opened
        self._seq = 0
        self.carries, self.listens = ask is not None, True
        for name in names:
            model = experiment.vehicles[name].model
            try:
                board = make_thrusters(lab, name, model, lab.serial.ports.get(name))
                self._boards[name] = stack.enter_context(board)
                board.epoch_us = self._began_ns // 1000
            except (ThrustersError, BoardError) as error:
                self._trouble[name] = str(error)

    @property
    def now(self) -> float:
        """See `Station`."""
        return 1e-9 * (monotonic_ns() - self._began_ns)

    def agree(self, what: str) -> bool:
        """See `Station`."""
        return self._agree is None or self._agree(what)

    def wait(self, seconds: float) -> None:
        """See `Station`. Boards whose pulse is over are disarmed."""
        end = self.now + seconds
        while (left := end - self.now) > 0.0:
            for name, at in list(self._closing.items()):
                if self.now >= at:
                    self._disarm(name)
            sleep_until_ns(monotonic_ns() + min(LOOK_NS, round(1e9 * left)))

    def poses(self) -> Mapping[str, Sequence[PoseSample]]:
        """See `Station`."""
        found: dict[str, list[PoseSample]] = {name: [] for name in self._names.values()}
        for exposure in self._source.poll():
            t = 1e-9 * (exposure.exposed_ns - self._began_ns)
            for body, sighting in exposure.bodies.items():
                if sighting.tracked:
                    pose = self._axes.to_table(sighting)
                    row = PoseSample(t, pose.x, pose.y, pose.theta)
                    found.setdefault(self._names.get(body, body), []).append(row)
        return found

    def board(self, name: str) -> BoardFacts:
        """See `Station`."""
        if name in self._trouble:
            return BoardFacts("", self._trouble[name])
        return BoardFacts(self._boards[name].board)

    def health(self, name: str) -> Health:
        """See `Station`."""
        return self._boards[name].health() if name in self._boards else NO_HEALTH

    def bearing(self, name: str, *, on: bool) -> None:
        """See `Station`."""
        if name in self._boards:
            if not on:
                self._disarm(name)
            self._boards[name].bearing(on=on)

    def fire(self, name: str, jet: int, seconds: float) -> float:
        """See `Station`."""
        board, jets = self._boards[name], len(self._experiment.vehicles[name].model.jets)
        self._seq += 1
        on = tuple(round(1e6 * seconds) if k == jet else 0 for k in range(jets))
        board.edges()
        self._heard[name] = 0
        board.arm()
        now = self.now
        board.apply(ValveCommand(self._seq, now, now + seconds + KEPT_S, on, (0,) * jets))
        self._closing[name] = now + seconds + 0.5 * KEPT_S
        return now

    def clicked(self, name: str, jet: int) -> bool:
        """See `Station`: the board has switched its output, and the person heard it."""
        for _, mask in self._boards[name].edges():
            self._heard[name] |= mask
        switched = bool(self._heard[name] >> jet & 1)
        return switched and (self._ask is None or self._ask(f"did valve {jet + 1} click?"))

    def carry(self, name: str, mark: Mark) -> bool:
        """See `Station`."""
        x, y, theta = mark
        way = f"x = {x:.2f} m, y = {y:.2f} m, its x axis {57.2958 * theta:.0f} deg from the table's"
        return self._ask is not None and self._ask(f"put {name} at {way}, hands off. Done?")

    def _disarm(self, name: str) -> None:
        if self._closing.pop(name, None) is not None:
            self._boards[name].disarm()
