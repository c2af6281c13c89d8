"""The drill's catalogue: what goes wrong in labs, how it is injected, and what must be noticed.

A case is one row of the drill. Its name is that of its injection, or of what an operator would call
it. `unnoticed` says why a case may pass without a response; its contacts count all the same.

A frame that creeps begins to move all at once, and then evenly. To a vehicle that is the same as a
push at once, and only fixed bodies tell them apart. A vehicle with the board of another one spins
up, so the gate may shut its valves before a row of the fault table holds: that answers the fault,
but does not name it. So does `bumped` where frozen poses dither: they look like a wall.
"""

from msgspec import Struct

from testbed.core.codes import FaultId, InhibitReason
from testbed.core.fault_injection import VALUES, Kind

LINK = ("link_late", "link_out", "link_lost")
NEIGHBOUR = ("neighbour_late", "neighbour_missing", "neighbour_silent")
DEAF = (*LINK, "neighbour_late", "neighbour_missing")  # nobody else is silent
POSES_STOP = ("pose_stale", "pose_missing", "pose_lost")
POSES_WRONG = ("pose_jumped", "estimator_inconsistent", "pose_swapped", "pose_frozen")
STANDS_WRONG = ("start", "heading", "fence")  # arming checks
PUSHED = ("valve_stuck_open", "valve_leaks", "valve_leaks_or_weak", "valve_stuck_closed")
SHIFTED = ("frame_shifted", "heading_shifted")
LATE = ("poses_late", "poses_step_back")
SCALED = ("thrust_or_mass", "pulled_hard")  # by which wrong wiring shows, if not by one jet
SUPPLY = ("supply_weak", "supply_low", "leak")
HOST = ("operator_gone", *LINK)
SMALL = "so small that the flight goes on"
FOLLOWED = "no pose contradicts another: only fixed reference bodies show it"
EITHER_RIG, BENCH = ("twin", "bench"), ("bench",)
SOON = 8.0  # [s]


class Case(Struct, frozen=True):
    """One row of the drill."""

    kind: Kind
    names: tuple[str, ...]  # ids of the faults or red arming checks that identify it
    sizes: tuple[float, float] | None = None  # range of `value`; None: its usual value
    in_periods: bool = False  # `sizes` are in jet periods, not in seconds
    lasts: tuple[float, float] | None = None  # range [s]; None: to the end
    at_start: bool = False  # there before the arming checks
    rigs: tuple[str, ...] = EITHER_RIG
    flown_s: float = SOON  # of flight after it began [s]
    on_wires: tuple[str, ...] = ()  # further names that only occur on wires
    unnoticed: str = ""  # why no response is needed; empty: one is
    answers: tuple[str, ...] = ()  # ids of further faults that notice it without naming it
    alike: tuple[str, ...] = ()  # ids that it cannot be told from: neither right nor wrong names

    @property
    def range(self) -> tuple[float, float] | None:
        """Range of the injection's `value`; None: it has none."""
        usual = VALUES.get(self.kind)
        return self.sizes or (None if usual is None else (usual, usual))


CATALOGUE: dict[str, Case] = {
    "drop_mocap": Case("drop_mocap", POSES_STOP),
    "freeze_mocap": Case("freeze_mocap", ("pose_frozen",)),
    "jump_mocap": Case("jump_mocap", ("pose_jumped",), (0.15, 0.9)),
    "noisy_mocap": Case(
        "noisy_mocap", ("estimator_inconsistent", "pose_jumped", "pose_stale"), (0.01, 0.06)
    ),
    "swap_bodies": Case("swap_bodies", ("pose_swapped",)),
    "delay_link": Case(
        "delay_link", DEAF, (6.0, 18.0), in_periods=True, on_wires=("operator_gone",)
    ),
    "lose_link": Case("lose_link", DEAF, on_wires=("operator_gone",)),
    "kill_process": Case("kill_process", (*NEIGHBOUR, FaultId.VEHICLE_SILENT)),
    "stick_open": Case("stick_open", ("valve_stuck_open", "valve_leaks", "valve_leaks_or_weak")),
    "stick_closed": Case(
        "stick_closed", ("valve_stuck_closed", "valve_leaks_or_weak"), flown_s=40.0
    ),
    "leak_valve": Case(
        "leak_valve", ("valve_leaks", "valve_leaks_or_weak", "valve_stuck_open"), (0.15, 0.6),
        flown_s=20.0,
    ),
    "leak": Case("leak", SUPPLY, (0.05, 0.2)),
    "brown_out": Case(
        "brown_out", ("battery_low", "board_silent"), on_wires=(FaultId.LINE_LOST,)
    ),
    "clock_step": Case("clock_step", ("clock_off",), (0.025, 0.5), on_wires=POSES_STOP),
    "nan_law": Case("nan_law", ("not_a_number", FaultId.HOST_LAW_NOT_A_NUMBER)),
    "raise_law": Case("raise_law", ("law_raised", FaultId.HOST_LAW_RAISED)),
    "operator_gone": Case("operator_gone", ("operator_gone",)),
    "disk_full": Case("disk_full", ("disk_full",)),
    "config_differs": Case("config_differs", ("config_differs",)),
    "overrun": Case(
        "overrun", ("overrun",), (0.64, 2.4), in_periods=True,
        on_wires=(FaultId.BOARD_LEFT_ARMED,),
    ),
    # cameras
    "occlusion": Case("drop_mocap", POSES_STOP, lasts=(0.6, 3.0)),
    "dithered_freeze": Case(
        "freeze_mocap", (*POSES_WRONG, *PUSHED), (1e-9, 2e-5), answers=("bumped",)
    ),
    "heading_flips": Case("turn_body", (*POSES_WRONG, "heading_shifted"), (180.0, 180.0)),
    "heading_jumps": Case("turn_body", SHIFTED, (3.0, 5.0)),
    "old_poses": Case("delay_mocap", (*LATE, *POSES_WRONG), (0.2, 0.4), unnoticed=SMALL),
    "slow_frames": Case("slow_mocap", ("pose_rate_low", "pose_missing", "pose_lost")),
    "frame_bumped": Case(
        "shift_frame", (*SHIFTED, "poses_step_back", "pose_jumped", FaultId.FRAME_MOVED),
        (0.005, 0.05),
    ),
    "frame_creeps": Case(
        "creep_frame", (FaultId.FRAME_MOVED,), (0.01, 0.03), unnoticed=FOLLOWED, alike=("nudged",)
    ),
    "origin_moved": Case(
        "shift_frame", ("start",), (0.05, 0.15), at_start=True, unnoticed=FOLLOWED
    ),
    "body_turned": Case("turn_body", ("heading",), (45.0, 180.0), at_start=True),
    "frame_turned": Case("turn_frame", STANDS_WRONG, (45.0, 180.0), at_start=True),
    "y_axis_up": Case("tip_frame", (*STANDS_WRONG, "clear_of"), at_start=True),
    "millimetres": Case("scale_frame", STANDS_WRONG, at_start=True),
    # air
    "no_air": Case("empty_tank", ("supply",), at_start=True),
    "empty_tank": Case("empty_tank", SUPPLY),
    "regulator": Case("regulator", ("supply_high", *PUSHED), (1.3, 2.0)),
    "high_supply": Case("regulator", ("supply",), (1.3, 2.0), at_start=True),
    "sag": Case("sag", ("supply_low", "supply_weak")),
    "flat_battery": Case("flat_battery", ("battery_low",)),
    "weak_jet": Case(
        "weak_jet", (*PUSHED, "jet_weak"), (0.5, 0.7), flown_s=20.0, unnoticed=SMALL
    ),
    "weak_jets": Case("thrust", ("thrust_or_mass",), (0.5, 0.8), flown_s=20.0, unnoticed=SMALL),
    "dead_jet": Case(
        "stick_closed", ("valve_stuck_closed", "valve_leaks_or_weak"), at_start=True, flown_s=40.0
    ),
    "hose": Case("hose", ("pulled", "pulled_hard"), (0.05, 0.3), flown_s=20.0, unnoticed=SMALL),
    "drag_pad": Case("pad_drag", ("pads_drag",), (0.5, 2.0), flown_s=20.0, unnoticed=SMALL),
    # wiring
    "swap_jets": Case("swap_jets", (*PUSHED, *SCALED), flown_s=40.0),
    "reverse_jet": Case("reverse_jet", (*PUSHED, *SCALED), flown_s=40.0),
    "swap_boards": Case(
        "swap_boards", (*PUSHED, *SCALED, "estimator_inconsistent"), flown_s=20.0,
        answers=(InhibitReason.TOO_FAST.name.lower(),),
    ),
    "board_reboots": Case(
        "brown_out", ("battery_low", "board_silent"), lasts=(0.03, 0.1),
        on_wires=(FaultId.BOARD_RESET, FaultId.LINE_LOST),
    ),
    "cut_serial": Case("cut_serial", ("board_silent", FaultId.BOARD_LEFT_ARMED), rigs=BENCH),
    "usb_replugged": Case(
        "cut_serial", ("board_silent", FaultId.BOARD_LEFT_ARMED), lasts=(0.5, 1.5), rigs=BENCH
    ),
    # computers
    "roaming": Case("lose_link", DEAF, lasts=(2.5, 3.5), on_wires=("operator_gone",)),
    "stop_process": Case("stop_process", (*NEIGHBOUR, FaultId.VEHICLE_SILENT), rigs=BENCH),
    "pause_process": Case(
        "stop_process", ("overrun", FaultId.BOARD_LEFT_ARMED, *NEIGHBOUR), lasts=(0.05, 0.5),
        rigs=BENCH, unnoticed=SMALL,
    ),
    "foreign_session": Case("foreign_session", ("foreign",), rigs=BENCH),
    "flood": Case("flood", (FaultId.FLOODED,), rigs=BENCH),
    "no_files": Case("no_files", (), rigs=BENCH, unnoticed="a flight opens no file"),
    "kill_host": Case("kill_host", HOST, rigs=BENCH),
    "stop_host": Case("stop_host", HOST, rigs=BENCH),
    "host_suspended": Case(
        "stop_host", (FaultId.HOST_SUSPENDED,), lasts=(1.5, 3.0), rigs=BENCH
    ),
}  # fmt: skip
