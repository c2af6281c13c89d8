"""What host and board say to each other.

Written by `python -m firmware_interface.generate` from messages.toml: change it there.
"""

import struct
from enum import IntEnum, IntFlag
from typing import ClassVar

from firmware_interface.packed import Packed

VERSION = 2
VALVES = 8
EDGES = 8
PAYLOAD_MAX = 80


class State(IntEnum):
    """What the board may do."""

    BOOT = 0  # not usable: the limits it was built with contradict each other
    SAFE = 1  # all valves closed until armed
    ARMED = 2  # plays plans


class Result(IntEnum):
    """The board's answer to a frame."""

    OK = 0  # done
    REFRESHED = 1  # this plan is being played already: only the watchdog was fed
    FOREIGN_SESSION = 2  # of another session, or before HELLO: say HELLO
    OUT_OF_RANGE = 3  # a field is outside the limits of messages.toml
    NOT_ARMED = 4  # plans are played in ARMED only
    CONFIG_FAULT = 5  # the limits contradict each other; nothing can be armed
    UNDERVOLTAGE = 6  # the supply is too low to arm
    STALE_PLAN = 7  # older than the plan being played
    EXPIRED = 8  # its time to live is over already
    NO_SUCH_VALVE = 9  # an on-time for a valve this board does not have
    ON_TOO_LONG = 10  # an on-time above the board's max_on_us
    TTL_TOO_LONG = 11  # a time to live above the board's max_ttl_us
    OPPOSING = 12  # opposing valves open together, or closer than the dead time


class ResetCause(IntEnum):
    """Why the board booted."""

    UNKNOWN = 0  # the port cannot tell
    POWER_ON = 1  # power came
    BROWN_OUT = 2  # the supply dipped
    PIN = 3  # reset button or debugger
    SOFTWARE = 4  # asked for by the firmware
    WATCHDOG = 5  # the independent watchdog: the firmware hung


class BearingPolicy(IntEnum):
    """What becomes of bearing air when the board trips."""

    KEEP = 0  # stays as it is: the vehicle drifts
    DROP = 1  # off, land_after_us later: the vehicle stands


class Fault(IntFlag):
    """Reasons for SAFE; latched until the next ARM."""

    WATCHDOG = 1  # no accepted plan for watchdog_us
    UNDERVOLTAGE = 2  # supply below undervoltage_mv for undervoltage_us
    CONFIG = 4  # limits contradict each other
    INTERLOCK = 8  # the output stage was asked to open opposing valves


class Hello(Packed, frozen=True, gc=False):
    """Start a session: closes everything, disarms, forgets plans and sequence numbers."""

    CODE: ClassVar[int] = 1
    LAYOUT: ClassVar[struct.Struct] = struct.Struct("<I")
    COUNTS: ClassVar[tuple[int, ...]] = (0,)
    ENUMS: ClassVar[dict[str, type]] = {}
    LIMITS: ClassVar[dict[str, tuple[int, int]]] = {}

    host_nonce: int  # echoed, so that the host knows its own answer


class Arm(Packed, frozen=True, gc=False):
    """SAFE to ARMED; clears latched faults and starts the watchdog."""

    CODE: ClassVar[int] = 2
    LAYOUT: ClassVar[struct.Struct] = struct.Struct("<I")
    COUNTS: ClassVar[tuple[int, ...]] = (0,)
    ENUMS: ClassVar[dict[str, type]] = {}
    LIMITS: ClassVar[dict[str, tuple[int, int]]] = {}

    session: int  # from HELLO_ACK


class Disarm(Packed, frozen=True, gc=False):
    """Close everything. Needs no session: anyone may close."""

    CODE: ClassVar[int] = 3
    LAYOUT: ClassVar[struct.Struct] = struct.Struct("<")
    COUNTS: ClassVar[tuple[int, ...]] = ()
    ENUMS: ClassVar[dict[str, type]] = {}
    LIMITS: ClassVar[dict[str, tuple[int, int]]] = {}


class Cmd(Packed, frozen=True, gc=False):
    """A complete plan, a pulse per valve; sent again with a new age it only feeds the watchdog."""

    CODE: ClassVar[int] = 4
    LAYOUT: ClassVar[struct.Struct] = struct.Struct("<IIII8I8I")
    COUNTS: ClassVar[tuple[int, ...]] = (
        0,
        0,
        0,
        0,
        8,
        8,
    )
    ENUMS: ClassVar[dict[str, type]] = {}
    LIMITS: ClassVar[dict[str, tuple[int, int]]] = {
        "age_us": (0, 10000000),
        "ttl_us": (1, 10000000),
        "on_us": (0, 10000000),
        "offset_us": (0, 10000000),
    }

    session: int  # from HELLO_ACK
    plan: int  # number of the plan, rising, wraps
    age_us: int  # since the plan began, when this frame was sent [us]
    ttl_us: int  # from the plan's beginning to all closed [us]
    on_us: tuple[int, ...]  # open time [us]
    offset_us: tuple[int, ...]  # from the plan's beginning to opening [us]


class Bearing(Packed, frozen=True, gc=False):
    """Bearing air on or off; needs a session, not ARMED: a vehicle floats before it flies."""

    CODE: ClassVar[int] = 5
    LAYOUT: ClassVar[struct.Struct] = struct.Struct("<IB")
    COUNTS: ClassVar[tuple[int, ...]] = (
        0,
        0,
    )
    ENUMS: ClassVar[dict[str, type]] = {}
    LIMITS: ClassVar[dict[str, tuple[int, int]]] = {
        "on": (0, 1),
    }

    session: int  # from HELLO_ACK
    on: int  # 1: on


class Ping(Packed, frozen=True, gc=False):
    """Ask for an ACK: clocks and state. Feeds nothing."""

    CODE: ClassVar[int] = 6
    LAYOUT: ClassVar[struct.Struct] = struct.Struct("<")
    COUNTS: ClassVar[tuple[int, ...]] = ()
    ENUMS: ClassVar[dict[str, type]] = {}
    LIMITS: ClassVar[dict[str, tuple[int, int]]] = {}


class HelloAck(Packed, frozen=True, gc=False):
    """Who the board is."""

    CODE: ClassVar[int] = 129
    LAYOUT: ClassVar[struct.Struct] = struct.Struct("<IIIIIBBII")
    COUNTS: ClassVar[tuple[int, ...]] = (
        0,
        0,
        0,
        0,
        0,
        0,
        0,
        0,
        0,
    )
    ENUMS: ClassVar[dict[str, type]] = {"reset_cause": ResetCause, "state": State}
    LIMITS: ClassVar[dict[str, tuple[int, int]]] = {}

    host_nonce: int  # of the HELLO answered
    session: int  # to be quoted from now on
    boot_nonce: int  # differs after every boot
    firmware_id: int  # first 32 bits of the hash of its sources
    config_hash: int  # CRC-32 of the limits record
    reset_cause: ResetCause  # why it booted
    state: State
    t1_us: int  # t_us of the HELLO, host's clock [us]
    t2_us: int  # when its last byte came in, board's clock [us]


class Ack(Packed, frozen=True, gc=False):
    """Answer to one frame; with its own t_us as T3 it gives clock offset and delay."""

    CODE: ClassVar[int] = 130
    LAYOUT: ClassVar[struct.Struct] = struct.Struct("<HBBBBBII")
    COUNTS: ClassVar[tuple[int, ...]] = (
        0,
        0,
        0,
        0,
        0,
        0,
        0,
        0,
    )
    ENUMS: ClassVar[dict[str, type]] = {"result": Result, "state": State, "faults": Fault}
    LIMITS: ClassVar[dict[str, tuple[int, int]]] = {}

    seq: int  # of the frame answered
    type: int  # of the frame answered
    result: Result
    state: State  # after the frame
    faults: Fault  # after the frame
    mask: int  # valves open
    t1_us: int  # t_us of the frame answered, host's clock [us]
    t2_us: int  # when its last byte came in, board's clock [us]


class Status(Packed, frozen=True, gc=False):
    """Telemetry, every status_period_us from boot on. Counters wrap."""

    CODE: ClassVar[int] = 131
    LAYOUT: ClassVar[struct.Struct] = struct.Struct("<IBBBBI8IHIIHHHHHHHHHHHHH")
    COUNTS: ClassVar[tuple[int, ...]] = (
        0,
        0,
        0,
        0,
        0,
        0,
        8,
        0,
        0,
        0,
        0,
        0,
        0,
        0,
        0,
        0,
        0,
        0,
        0,
        0,
        0,
        0,
        0,
    )
    ENUMS: ClassVar[dict[str, type]] = {"state": State, "faults": Fault}
    LIMITS: ClassVar[dict[str, tuple[int, int]]] = {}

    session: int  # 0 before the first HELLO
    state: State
    faults: Fault
    mask: int  # valves open
    bearing: int  # 1: bearing air on
    plan: int  # the newest plan accepted
    open_us: tuple[int, ...]  # open time since boot, wraps [us]
    supply_mv: int  # valve supply [mV]
    supply_pa: int  # behind the regulator [Pa]
    worst_late_us: int  # greatest lateness of a run since boot [us]
    bad_length: int  # frames too short, too long, or of a wrong length for their type
    bad_crc: int  # frames
    bad_version: int  # frames
    unknown_type: int  # frames
    foreign: int  # frames of another session
    replayed: int  # frames with a sequence number already used
    refused: int  # frames answered by neither OK nor REFRESHED
    watchdog_trips: int
    unplayed: int  # pulses not played: too short, or too short when the valve was free
    cut_max_on: int  # openings ended by max_on_us
    cut_duty: int  # openings ended by the duty budget
    lost_acks: int  # answers never sent: more frames than the line back carries
    lost_edges: int  # edges not reported


class Edges(Packed, frozen=True, gc=False):
    """Valve outputs as they were driven, oldest first."""

    CODE: ClassVar[int] = 132
    LAYOUT: ClassVar[struct.Struct] = struct.Struct("<B8I8B")
    COUNTS: ClassVar[tuple[int, ...]] = (
        0,
        8,
        8,
    )
    ENUMS: ClassVar[dict[str, type]] = {}
    LIMITS: ClassVar[dict[str, tuple[int, int]]] = {
        "count": (0, 8),
    }

    count: int  # entries used
    at_us: tuple[int, ...]  # board's clock [us]
    mask: tuple[int, ...]  # valves open from then on


class Config(Packed, frozen=True, gc=False):
    """Valve map and limits."""

    LAYOUT: ClassVar[struct.Struct] = struct.Struct("<B8BIBIIIIIIIIIHII")
    COUNTS: ClassVar[tuple[int, ...]] = (
        0,
        8,
        0,
        0,
        0,
        0,
        0,
        0,
        0,
        0,
        0,
        0,
        0,
        0,
        0,
        0,
    )
    ENUMS: ClassVar[dict[str, type]] = {"bearing_after_trip": BearingPolicy}
    LIMITS: ClassVar[dict[str, tuple[int, int]]] = {
        "valve_count": (1, 8),
        "bearing_after_trip": (0, 1),
        "land_after_us": (0, 60000000),
        "min_on_us": (0, 1000000),
        "min_off_us": (0, 1000000),
        "dead_us": (0, 1000000),
        "max_on_us": (1, 10000000),
        "duty_window_us": (16000, 160000000),
        "duty_budget_us": (1, 160000000),
        "max_ttl_us": (1, 10000000),
        "watchdog_us": (1000, 2000000),
        "undervoltage_mv": (0, 60000),
        "undervoltage_us": (0, 1000000),
        "status_period_us": (1000, 10000000),
    }

    valve_count: int
    opposing: tuple[int, ...]  # per valve, mask of the valves that push against it
    jets: int  # CRC-32 of where the jets are and which way they push; only hashed
    bearing_after_trip: BearingPolicy
    land_after_us: int  # from a trip to bearing air off; ARM and BEARING cancel it [us]
    min_on_us: int  # shorter pulses are not played [us]
    min_off_us: int  # a valve stays closed at least so long [us]
    dead_us: int  # between a valve's closing and its opposite's opening [us]
    max_on_us: int  # per opening [us]
    duty_window_us: int  # multiple of 16 [us]
    duty_budget_us: int  # open time of a valve in any duty window [us]
    max_ttl_us: int  # of a plan [us]
    watchdog_us: int  # without an accepted plan [us]
    undervoltage_mv: int  # 0: the board has no voltmeter [mV]
    undervoltage_us: int  # so long below before it trips [us]
    status_period_us: int  # [us]


Message = Hello | Arm | Disarm | Cmd | Bearing | Ping | HelloAck | Ack | Status | Edges
TYPES: dict[int, type[Message]] = {
    1: Hello,
    2: Arm,
    3: Disarm,
    4: Cmd,
    5: Bearing,
    6: Ping,
    129: HelloAck,
    130: Ack,
    131: Status,
    132: Edges,
}
