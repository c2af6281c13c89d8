"""Firmware in the loop: boards that can execute the plans of an experiment.

    model      default; on the twin a fast model without firmware; on the bench the same as `host`
    inproc     the firmware's C core in this process, on the twin
    unicorn    the image that is flashed, on an emulated chip, on the twin
    host       the firmware as a process on this machine, on the bench
    qemu       the image that is flashed, in QEMU, on the bench

The twin's boards run in lockstep with it, behind a modelled serial line; the bench's boards run in
real time, behind a real one. On the table the boards are the lab's hardware.
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
    """The outputs of a board from time `t` on."""

    t: float  # [s]
    mask: int  # bit 0 is jet 1; 1 is open


def make_board(kind: str, config: Config) -> Board:
    """A board in virtual time.

    Raises:
        ConfigError: this machine cannot build or run its firmware.
    """
    try:
        if kind == "inproc":
            return InprocBoard(config)
        from firmware_interface.unicorn_board import UnicornBoard  # large optional dependency

        return UnicornBoard(config)
    except ImportError as error:
        expected = f"the chip's emulator: {pip_install('emulator')}"
        raise ConfigError("this machine", "board", expected, f"{kind}: {error}") from error
    except CompilerError as error:
        raise _not_here(kind, error) from error


def _not_here(kind: str, error: Exception) -> ConfigError:
    expected = "a board that this machine can build and run; on the twin `model` needs no tools"
    return ConfigError("this machine", "board", expected, f"{kind}: {error}")


def check_boards(kind: str, vehicles: Mapping[str, Vehicle], rig: str = "twin") -> None:
    """Check that the boards can be built, before a run writes any file.

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
    """Check the boards of the bench: its firmware runs as processes; `model` means `host`."""
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
    """An armed board for each vehicle; None: the twin uses its own model."""
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
