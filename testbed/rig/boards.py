"""Firmware in the loop: what can play the plans of an experiment.

    model      on the twin its own, the default: no firmware, fast; on the bench the same as `host`
    inproc     the firmware's C core in this process, on the twin
    unicorn    the image that is flashed, on an emulated chip, on the twin
    host       the firmware as a process on this machine, on the bench
    qemu       the image that is flashed, in QEMU, on the bench

Those of the twin run in lockstep with it, behind a modelled serial line; those of the bench in real
time, behind a real one. On the table the boards are the lab's.
"""

import weakref
from collections.abc import Mapping

from msgspec import Struct

from firmware_interface.board import Board
from firmware_interface.compiler import CompilerError, host_program
from firmware_interface.inproc import InprocBoard
from firmware_interface.limits import limits_of
from firmware_interface.messages import Config
from firmware_interface.wire import WiredBoard
from testbed.config import ConfigError
from testbed.core.extra import pip_install
from testbed.core.vehicle import Vehicle

REAL_TIME = ("host", "qemu")
LOCKSTEP = ("inproc", "unicorn")


class Valves(Struct, frozen=True, gc=False):
    """The outputs of a board from a time on."""

    t: float  # [s]
    mask: int  # jet 0 is bit 0, 1 is open


def make_board(kind: str, config: Config) -> Board:
    """A board in virtual time.

    Raises:
        ConfigError: this machine cannot build or run its firmware.
    """
    try:
        if kind == "inproc":
            return InprocBoard(config)
        from firmware_interface.unicorn_board import UnicornBoard  # a large tool of developers

        return UnicornBoard(config)
    except ImportError as error:
        expected = f"the chip's emulator: {pip_install('emulator')}"
        raise ConfigError("this machine", "board", expected, f"{kind}: {error}") from error
    except CompilerError as error:
        raise _not_here(kind, error) from error


def _not_here(kind: str, error: Exception) -> ConfigError:
    expected = "a board that this machine can build and run; on the twin `model` needs nothing"
    return ConfigError("this machine", "board", expected, f"{kind}: {error}")


def check_boards(kind: str, vehicles: Mapping[str, Vehicle], rig: str = "twin") -> None:
    """Find out before a flight leaves anything behind whether there will be boards.

    Raises:
        ConfigError: this machine cannot build or run their firmware.
    """
    if rig == "bench":
        _check_wired(kind, vehicles)
    elif rig == "twin" and kind in LOCKSTEP:
        kinds = {config.pack(): config for config in map(limits_of, vehicles.values())}
        for config in kinds.values():
            make_board(kind, config).close()


def _check_wired(kind: str, vehicles: Mapping[str, Vehicle]) -> None:
    """The bench's firmware runs as processes; `model` is `host` there."""
    from firmware_interface.qemu import qemu_command  # loads the serial port
    from firmware_interface.serial_board import BoardError

    try:
        if kind in ("model", "host"):
            host_program()
        elif kind == "qemu":
            for vehicle in vehicles.values():
                qemu_command(limits_of(vehicle))
    except (CompilerError, BoardError) as error:
        raise _not_here(kind, error) from error


def make_drivers(kind: str, vehicles: Mapping[str, Vehicle]) -> dict[str, WiredBoard] | None:
    """A board for each vehicle, armed; None for the twin's own."""
    if kind == "model":
        return None
    if kind in REAL_TIME:
        raise ConfigError("this rig", "board", "model, inproc or unicorn on the twin", kind)
    drivers = {}
    for name, vehicle in vehicles.items():
        config = limits_of(vehicle)
        drivers[name] = WiredBoard(make_board(kind, config), config)
        weakref.finalize(drivers[name], drivers[name].board.close)
    return drivers
