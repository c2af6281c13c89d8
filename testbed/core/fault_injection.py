"""Fault injection: `[[inject]]` in an experiment file, so that a lab can rehearse faults.

[[inject]]
kind = "drop_mocap"
vehicle = "sat2"
at_s = 31.4             # or: event = "near_obstacle", threshold = 1.0
for_s = 0.3             # default: to the end
"""

from typing import Literal

from msgspec import Struct

from testbed.core.error import MismatchError
from testbed.core.vehicle import NonNegative, Positive

Kind = Literal[
    "drop_mocap",  # poses stop
    "freeze_mocap",  # the same pose again and again, with fresh stamps and noise of `value` [m]
    "jump_mocap",  # all poses shifted by `value` [m]
    "noisy_mocap",  # all poses with noise of `value` [m]
    "swap_bodies",  # poses are swapped with those of `other`
    "turn_body",  # the heading of its poses is off by `value` [deg]
    "delay_mocap",  # its poses are `value` [s] older than their stamps
    "slow_mocap",  # only `value` poses a second
    "shift_frame",  # the cameras' frame moves: all bodies are shifted by `value` [m]
    "turn_frame",  # all bodies are turned about the table's centre by `value` [deg]
    "creep_frame",  # all bodies creep by `value` [m/s]
    "scale_frame",  # the cameras say `value` times the position: millimetres for metres is 1000
    "tip_frame",  # the cameras' y axis points up
    "delay_link",  # messages to the vehicle take `value` [s] longer
    "lose_link",  # messages to the vehicle are lost with the probability `value`
    "kill_process",  # the vehicle's process is killed
    "stick_open",  # valve number `jet` stays open
    "stick_closed",  # valve number `jet` stays shut
    "leak_valve",  # valve number `jet` leaks the share `value` of its flow when shut
    "weak_jet",  # valve number `jet` gives only the share `value` of its thrust
    "half_open",  # valve number `jet` gives the share `value` of its thrust, whatever is commanded
    "hose",  # a hose or cable pulls with `value` [N]
    "pad_drag",  # the pads drag with `value` [N s/m]
    "regulator",  # the supply pressure is `value` times the set pressure, as the gauge shows
    "thrust",  # all jets give `value` times the thrust of the file, and the gauge shows nothing
    "mass",  # the vehicle has `value` times the mass of the file
    "swap_jets",  # the wires of valves number `jet` and `value` are swapped
    "reverse_jet",  # jet number `jet` pushes the other way: its sign in the file is wrong
    "swap_boards",  # the boards of the vehicle and of `other` are swapped
    "empty_tank",
    "leak",  # `value` [kg/s] of gas
    "brown_out",  # the board loses its power
    "sag",  # the board reads a supply pressure of the share `value`
    "flat_battery",  # the board reads `value` [V]
    "clock_step",  # the vehicle's clock and the cameras' differ by `value` [s]
    "nan_law",  # the law's force is not a number
    "raise_law",  # the law raises an exception
    "operator_gone",  # the operator's presence is no longer reported
    "disk_full",
    "config_differs",
    "overrun",  # every tick begins `value` [s] late
    # only on the bench
    "stop_process",  # the vehicle's process hangs
    "cut_serial",  # the line to its board is cut
    "foreign_session",  # another session sends setpoints to the vehicle
    "flood",  # the host's network sends `value` senseless setpoints a second to the vehicle
    "no_files",  # the vehicle's process can open no further file
    "kill_host",
    "stop_host",  # the host's process hangs
]
ON_WIRES: tuple[Kind, ...] = (
    "stop_process", "cut_serial", "foreign_session", "flood", "no_files", "kill_host", "stop_host",
)  # fmt: skip
WITH_OTHER: tuple[Kind, ...] = ("swap_bodies", "swap_boards")
OF_FRAME: tuple[Kind, ...] = (  # all vehicles see them
    "shift_frame", "creep_frame", "turn_frame", "scale_frame", "tip_frame",
)  # fmt: skip

EVENTS = Literal["near_obstacle", "near_vehicle", "near_edge", "faster_than"]

VALUES: dict[str, float] = {  # defaults
    "jump_mocap": 0.3,
    "noisy_mocap": 0.02,
    "delay_link": 0.6,
    "lose_link": 1.0,
    "leak": 0.1,
    "leak_valve": 0.3,
    "turn_body": 5.0,
    "half_open": 0.5,
    "thrust": 0.67,
    "mass": 1.5,
    "clock_step": 0.05,
    "overrun": 0.08,
    "sag": 0.5,
    "flat_battery": 9.0,
    "delay_mocap": 0.3,
    "slow_mocap": 4.0,
    "shift_frame": 0.05,
    "creep_frame": 0.01,
    "turn_frame": 90.0,
    "scale_frame": 1000.0,
    "weak_jet": 0.5,
    "hose": 0.1,
    "pad_drag": 2.0,
    "regulator": 1.5,
    "flood": 1e4,
}


class Injection(Struct, frozen=True, forbid_unknown_fields=True):
    """One fault, at a time or at an event."""

    kind: Kind
    vehicle: str
    at_s: NonNegative | None = None  # [s]
    event: EVENTS | None = None
    threshold: Positive | None = None  # of the event, centre to centre [m], or [m/s]
    for_s: Positive = 1e6
    value: float | None = None  # see `Kind`
    jet: int = 1  # counted from 1, as in the vehicle file's picture
    other: str = ""  # the other vehicle of a swap
    towards_deg: float = 0.0  # direction in W of a hose, or of a frame that moves

    def __post_init__(self) -> None:
        if (self.at_s is None) == (self.event is None):
            raise MismatchError("one of `at_s` and `event`", "both or neither")
        if (self.event is None) != (self.threshold is None):
            raise MismatchError("`threshold` with `event` and only then", "otherwise")
        if (self.kind in WITH_OTHER) != bool(self.other):
            raise MismatchError("`other` with a swap and only then", "otherwise")

    @property
    def size(self) -> float:
        """`value`, or the default of the kind."""
        return VALUES.get(self.kind, 0.0) if self.value is None else self.value
