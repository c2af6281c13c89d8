"""The driver of a vehicle's valves: the serial board, or a plug-in (group `testbed.thrusters`).

A plug-in is a class or function. It is called with the `options` of [lab.thrusters], and with
`vehicle`, `name` and `clock` where it has such parameters. What it returns is a `ThrusterBoard`.
"""

import threading
from collections import deque
from collections.abc import Callable
from typing import Any, Protocol

import msgspec
from msgspec.structs import replace

from firmware_interface.limits import limits_of
from firmware_interface.serial_thrusters import SerialThrusters, ThrustersError
from testbed.core import plugin
from testbed.core.codes import FaultId, FaultReport
from testbed.core.lab import THRUSTER_SYSTEMS, Lab
from testbed.core.ports import ThrusterBoard, Thrusters
from testbed.core.types import Health, ValveCommand
from testbed.core.vehicle import Vehicle
from testbed.realtime.wall_clock import MonotonicClock, monotonic_ns

FAILED = object()  # instead of an answer


class WiredThrusters(Thrusters, Protocol):
    """Interface of all thrusters to a vehicle's process; see `SerialThrusters`."""

    epoch_us: int
    sent: deque[tuple[int, int]]
    trouble: FaultReport | None

    def __enter__(self) -> "WiredThrusters": ...
    def __exit__(self, *_: object) -> None: ...
    @property
    def board(self) -> str: ...  # noqa: D102
    @property
    def reconnects(self) -> int: ...  # noqa: D102
    @property
    def refusals(self) -> dict[str, int]: ...  # noqa: D102
    @property
    def shut(self) -> bool: ...  # noqa: D102
    @property
    def floats(self) -> bool: ...  # noqa: D102
    def bearing(self, *, on: bool) -> None: ...  # noqa: D102
    def arm(self) -> None: ...  # noqa: D102
    def disarm(self) -> None: ...  # noqa: D102
    def edges(self) -> list[tuple[float, int]]: ...  # noqa: D102


def make_thrusters(lab: Lab, name: str, vehicle: Vehicle, port: str | None) -> WiredThrusters:
    """The thrusters of a vehicle; `port` is of the serial board.

    Raises:
        ThrustersError: the plug-in cannot be used.
    """
    if lab.thrusters.system not in THRUSTER_SYSTEMS:
        return PluggedThrusters(lab.thrusters.system, lab.thrusters.options, name, vehicle)
    assert port is not None
    return SerialThrusters(
        port, limits_of(vehicle), vehicle.command_delay_s, monotonic_ns() & 0xFFFFFFFF,
        lab.serial.baud, vehicle.air.set_pressure, vehicle.gauges,
    )  # fmt: skip


class PluggedThrusters:
    """`WiredThrusters` on top of a `ThrusterBoard`; the first time that it fails is `trouble`.

    Plans are handed over in the plug-in's time, the monotonic clock: they start `command_delay_s`
    after they were issued. Calls come one after the other.
    """

    reconnects = 0

    def __init__(self, system: str, options: dict[str, Any], name: str, vehicle: Vehicle) -> None:
        self.board = f"[lab.thrusters] system = {system!r}"
        self._delay_s = vehicle.command_delay_s
        self._lock = threading.RLock()
        self._armed, self._edges, self._mask = False, list[tuple[float, int]](), 0
        self.epoch_us, self.trouble, self.refusals = 0, None, dict[str, int]()
        self.floats = False  # whether bearing air is on, as far as the plug-in obeyed
        self.sent = deque[tuple[int, int]](maxlen=1000)
        self._clock = MonotonicClock()
        provided = {"vehicle": vehicle, "name": name, "clock": self._clock}
        try:
            made = plugin.load(plugin.THRUSTERS, system, THRUSTER_SYSTEMS)
            kind = plugin.option_type(made, plugin.PROVIDED[plugin.THRUSTERS])
            values = msgspec.convert(options, kind)
            self._driver: ThrusterBoard = plugin.call(made, values, provided)
        except (plugin.PluginError, msgspec.ValidationError) as error:
            raise ThrustersError(f"{self.board}: {error}") from error
        except Exception as error:  # a plug-in may raise anything
            why = f"{type(error).__name__}: {error}"
            raise ThrustersError(f"{self.board} cannot be used: {why}") from error

    trouble: FaultReport | None

    def __enter__(self) -> "PluggedThrusters":
        self._health = self._ask(self._driver.health, None)
        if self._health is None:
            self._ask(self._driver.close, None)
            raise ThrustersError(
                self.trouble.text if self.trouble else f"{self.board} does not report its health"
            )
        return self

    def __exit__(self, *_: object) -> None:
        self.disarm()
        self._ask(self._driver.close, None)

    def _ask(self, verb: Callable[..., Any], otherwise: Any, *words: Any, **more: Any) -> Any:
        """Call the plug-in; an exception becomes `trouble`."""
        with self._lock:
            try:
                return verb(*words, **more)
            except Exception as error:  # a plug-in may raise anything
                why = f"{type(error).__name__}: {error}"
                text = f"{self.board} failed: {why}"
                self.trouble = self.trouble or FaultReport(FaultId.BOARD_FAILED, text)
                return otherwise

    def bearing(self, *, on: bool) -> None:
        """See `SerialThrusters`."""
        if self._ask(self._driver.bearing, FAILED, on=on) is not FAILED:
            self.floats = on
        if self.trouble is not None:
            raise ThrustersError(self.trouble.text)

    def arm(self) -> None:
        """Pass plans to the plug-in from now on."""
        if self.trouble is not None:
            raise ThrustersError(self.trouble.text)
        self._armed = True

    def disarm(self) -> None:
        """Close every valve, now."""
        with self._lock:
            self._armed = False
            self._ask(self._driver.disarm, None)

    def land(self) -> None:
        """See `Thrusters`."""
        self.disarm()
        if self._ask(self._driver.land, FAILED) is not FAILED:
            self.floats = False

    def apply(self, command: ValveCommand) -> None:
        """See `Thrusters`."""
        with self._lock:
            if not self._armed:
                return
            shift = 1e-6 * self.epoch_us + self._delay_s
            start = command.issued_at + shift
            moved = replace(command, issued_at=start, valid_until=command.valid_until + shift)
            self._ask(self._driver.apply, None, moved)
            self.sent.append((command.seq, round(1e6 * max(start, self._clock.now))))

    def health(self) -> Health:
        """See `Thrusters`; after a failure the last health, with its age."""
        with self._lock:
            now, before = self._clock.now, self._health
            self._health = self._ask(self._driver.health, before)
            silent = self._health.silent_s
            if self._health is before:
                silent = max(silent, now - before.t)
            return replace(self._health, t=now - 1e-6 * self.epoch_us, silent_s=silent)

    def edges(self) -> list[tuple[float, int]]:
        """Valve edges since the last call: time of the run [s], mask."""
        with self._lock:
            self._look()
            found, self._edges = self._edges, []
        return [(t - 1e-6 * self.epoch_us, mask) for t, mask in found]

    def _look(self) -> None:
        new = self._ask(self._driver.edges, [])
        self._edges += new
        if new:
            self._mask = new[-1][1]

    @property
    def shut(self) -> bool:
        """Whether every valve is closed."""
        with self._lock:
            self._look()
            return self._mask == 0
