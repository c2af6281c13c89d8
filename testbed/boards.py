"""Firmware in the loop: what can play the plans of an experiment on the twin.

    model      the twin's own, the default: no firmware, fast
    inproc     the firmware's C core in this process
    unicorn    the image that is flashed, on an emulated chip

The latter two run in lockstep with the twin, behind a modelled serial line.
"""

import weakref
from collections.abc import Mapping

from firmware_interface.board import Board
from firmware_interface.inproc import InprocBoard
from firmware_interface.limits import limits_of
from firmware_interface.messages import Config
from firmware_interface.wire import WiredBoard
from testbed.core.vehicle import Vehicle


def make_board(kind: str, config: Config) -> Board:
    """A board in virtual time.

    Raises:
        CompilerError: this machine cannot build its firmware.
    """
    if kind == "inproc":
        return InprocBoard(config)
    from firmware_interface.unicorn_board import UnicornBoard  # a tool of developers, and large

    return UnicornBoard(config)


def make_drivers(kind: str, vehicles: Mapping[str, Vehicle]) -> dict[str, WiredBoard] | None:
    """A board for each vehicle, armed; None for the twin's own."""
    if kind == "model":
        return None
    drivers = {}
    for name, vehicle in vehicles.items():
        config = limits_of(vehicle)
        drivers[name] = WiredBoard(make_board(kind, config), config)
        weakref.finalize(drivers[name], drivers[name].board.close)
    return drivers
