"""Codes of responses, refusals, hazards and detectors with their words, and reports of faults.

Inside, codes are numbers: a record of a tick has room for a code and a few values. Words are made
where a person reads them: `.words` of a code, a `Refusal`, a `FaultReport` or an `Intervention`.
"""

import math
from enum import IntEnum, StrEnum, auto
from typing import TYPE_CHECKING, Literal, Self

from msgspec import Struct


class Code(IntEnum):
    """An enumeration member: a number and its words."""

    words: str

    def __new__(cls, code: int, words: str) -> Self:
        """Make a member from its code and its words."""
        member = int.__new__(cls, code)
        member._value_, member.words = code, words
        return member


class Response(Code):
    """Response to a fault, in order of severity; docs/safety.md explains them."""

    NONE = 0, ""
    WARN = 1, "warn"  # report it
    HOLD = 2, "hold"  # come to rest and wait; continue when the row no longer holds
    BRAKE = 3, "brake"  # stop relative to the table by the jets, then close every valve
    COAST = 4, "coast"  # close every valve at once and drift
    LAND = 5, "land"  # close every valve and turn the air off, including the bearings'


class InhibitReason(Code):
    """Reason why valves stay shut; the words say what the values of a `Refusal` mean."""

    NOT_ARMED = 1, "not armed"
    OTHER_SESSION = 2, "setpoints are of another session"
    NO_POSE_YET = 3, "no pose yet"
    NO_SETPOINT_YET = 4, "no setpoint yet"
    # from here to SUPPLY_NOT_FINITE: a fault, latched by the gate
    ESTIMATE_NOT_FINITE = 5, "estimate is not a number"
    DEMAND_NOT_FINITE = 6, "law or tracker asks for something that is not a number"
    POSE_TOO_OLD = 7, "no pose for {0:.2f} s (limit {1} s)"
    POSES_REJECTED = 8, "{0:.0f} poses contradict the estimate"
    SETPOINT_TOO_OLD = 9, "no setpoint for {0:.2f} s (limit {1} s)"
    OUTSIDE_FENCE = 10, "outside the fence at ({0:.2f}, {1:.2f}) m"
    TOO_FAST = 11, "too fast: ({0:.2f}, {1:.2f}) m/s, {2:.2f} rad/s"
    SUPPLY_NOT_FINITE = 12, "supply pressure is not a number"
    # the fault table and the end of the flight
    FAULT = 13, "a fault"
    RESPONSE = 14, "a row of the fault table holds"
    FLIGHT_OVER = 15, "the flight is over"
    # a vehicle that gives no ticks
    PROCESS_DEAD = 16, "its process is dead"
    VEHICLE_OVER = 17, "its flight is over"
    VEHICLE_SILENT = 18, "it is silent"
    NOT_HEARD_YET = 19, "not heard yet"
    # a plan that must not reach its board
    PLAN_TOO_LONG = 20, "a plan of {0:.3f} s (limit {1} s)"
    PLAN_FROM_FUTURE = 21, "a plan from the future"
    PLAN_EXPIRED = 22, "a plan that has expired"
    PLAN_REPLAYED = 23, "plan {0:.0f} after plan {1:.0f}"
    PLAN_INCOMPLETE = 24, "a plan that does not say when its pulses begin"
    PULSE_INVALID = 25, "a pulse of {0:.0f} us after {1:.0f} us in a plan of {2:.0f} us"


class Hazard(Code):
    """Kind of object that the safety filter keeps clear of."""

    OBSTACLE = 1, "an obstacle"
    VEHICLE = 2, "another vehicle"
    RIGHT_EDGE = 3, "the right edge"
    LEFT_EDGE = 4, "the left edge"
    UPPER_EDGE = 5, "the upper edge"
    LOWER_EDGE = 6, "the lower edge"
    TOP_SPEED = 7, "its top speed"


class Detector(Code):
    """Detectors of the fault table; the code is the place of its number in a tick's row."""

    POSE_AGE = 0, "pose_age"  # [s] since the newest accepted pose was captured
    POSE_REPEATS = 1, "pose_repeats"  # equal poses in a row
    POSE_JUMP = 2, "pose_jump"  # [m] of the newest pose from where it was expected
    POSE_OF_ANOTHER = 3, "pose_of_another"  # 1: the newest pose is where another vehicle should be
    POSES_REJECTED = 4, "poses_rejected"  # recently, by the estimator
    SETPOINT_AGE = 5, "setpoint_age"  # [s] since the newest setpoint was due
    SETPOINT_OVERDUE = 6, "setpoint_overdue"  # [s] since the newest setpoint expired
    NEIGHBOUR_AGE = 7, "neighbour_age"  # [s] age of the state of the vehicle not heard for longest
    SUPPLY_SHARE = 8, "supply_share"  # supply pressure over set pressure
    TANK_LOSS = 9, "tank_loss"  # [1/s] share of a full tank lost per second
    BATTERY = 10, "battery"  # [V]
    BOARD_SILENT = 11, "board_silent"  # [s]
    JET_OPEN = 12, "jet_open"  # share of its thrust that a jet gives without a command
    JET_LEAKS = 13, "jet_leaks"  # standard deviations by which a jet pushes while not commanded
    JET_LEAKS_OR_WEAK = 14, "jet_leaks_or_weak"  # the same, if a weak jet may explain it as well
    JET_MISSING = 15, "jet_missing"  # standard deviations by which a jet is too weak
    SPARE_ROOM = 16, "spare_room"  # [m] left after a full stop, to the nearest hazard
    LAW_ERROR = 17, "law_error"  # 1: the law raised an exception
    NOT_A_NUMBER = 18, "not_a_number"  # 1: the output of law or tracker is not finite
    TICK_LATE = 19, "tick_late"  # [s]
    OPERATOR_AGE = 20, "operator_age"  # [s] since the operator's presence was last heard
    CLOCK_OFFSET = 21, "clock_offset"  # [s] between host and vehicle, absolute
    CONFIG_DIFFERS = 22, "config_differs"  # 1: host and vehicle do not have the same configuration
    DISK_FREE = 23, "disk_free"  # [bytes]
    FOREIGN = 24, "foreign"  # messages of another session since the last tick
    FLEET = 25, "fleet"  # 1: another vehicle has a fault that stops all vehicles
    # causes of unexplained motion, standard deviations; 0: another cause may explain it as well
    JET_PARTLY_WEAK = 26, "jet_partly_weak"
    PULL = 27, "pull"  # a constant force: a hose, a cable, a tilt
    PULL_SHARE = 28, "pull_share"  # that force over what the jets can give in any direction
    PAD_DRAG = 29, "pad_drag"
    THRUST_OR_MASS = 30, "thrust_or_mass"  # all jets give more or less than the file says
    HEADING_OFF = 31, "heading_off"
    POSES_LATE = 32, "poses_late"  # older than their stamps
    # a body that is seen elsewhere without having been pushed
    LATE_STEP = 33, "late_step"  # [s] by how much older its poses may be since then
    FRAME_STEP = 34, "frame_step"  # [m] that it cannot be explained by a delay
    HEADING_STEP = 35, "heading_step"  # [rad] at the same place
    POSE_RATE = 36, "pose_rate"  # poses of the last second over what the cameras should give
    BUMPED = 37, "bumped"  # [m/s] change of velocity at once: a contact, or a hand
    NUDGED = 38, "nudged"  # standard deviations of a push at once, also one too small for BUMPED


class FaultId(StrEnum):
    """Faults that are no row of the fault table; a fault of the gate has its `InhibitReason`."""

    VEHICLE_SILENT = auto()  # the host hears nothing from it
    HOST_LAW_RAISED = auto()
    HOST_LAW_NOT_A_NUMBER = auto()
    LAW_STUCK = auto()  # it did not return, left threads running, or ended its process
    LAW_SLOW = auto()  # too slow for the bench and the table
    FRAME_MOVED = auto()  # the cameras see the reference bodies, or several vehicles, elsewhere
    BOARD_FAILED = auto()  # it no longer executes plans
    BOARD_LEFT_ARMED = auto()
    BOARD_RESET = auto()  # its valves and its bearing air are shut
    LINE_LOST = auto()  # the serial line to the board
    FLOODED = auto()  # so many unusable messages that a vehicle cannot read its own in time
    HOST_SUSPENDED = auto()  # the host's process did not run for a while
    NO_LEASE = auto()  # the host never permitted the flight
    STOPPED = auto()  # by an operator
    NOT_STARTED = auto()  # an arming check failed
    RIG_FAILED = auto()  # network or a process of the rig
    LOG_FAILED = auto()
    PROCESS_ENDED = auto()  # the run's own process did not finish


LATCHED = frozenset(  # inhibit reasons that are a fault; the gate latches all but the last
    range(InhibitReason.ESTIMATE_NOT_FINITE, InhibitReason.FAULT + 1)
)

# names that the fault table's file may use
if TYPE_CHECKING:
    ResponseName = str
    DetectorName = str
else:
    ResponseName = Literal[tuple(one.words for one in Response if one)]
    DetectorName = Literal[tuple(one.words for one in Detector)]


class Refusal(Struct, frozen=True, gc=False, omit_defaults=True):
    """Why valves stay shut, or why a plan is not sent."""

    code: InhibitReason
    values: tuple[float, ...] = ()  # in the order of the code's words

    @property
    def words(self) -> str:
        """The refusal as one sentence."""
        return self.code.words.format(*self.values, *(math.nan,) * 3)  # a message may lack some


class FaultCause(Struct, frozen=True, omit_defaults=True):
    """Kind of a fault and its vehicle."""

    id: str  # row of the fault table, name of an `InhibitReason`, or a `FaultId`
    text: str  # for the operator
    vehicle: str = ""  # empty: of the vehicle that reports it, or of none

    @property
    def title(self) -> str:
        """The fault in a few words, for a banner."""
        return self.id.replace("_", " ")


class FaultReport(FaultCause, frozen=True, omit_defaults=True):
    """A fault that ends a flight."""

    detector: str = ""  # of the row; empty: it is no row of the fault table
    value: float | None = None  # the detector's number
    cause: FaultCause | None = None  # the other vehicle's fault with which this one stops
    notes: tuple[str, ...] = ()  # what others know about it

    @property
    def origin(self) -> FaultCause:
        """The fault itself, or the other vehicle's with which it stops."""
        return self.cause or FaultCause(self.id, self.text, self.vehicle)

    @property
    def after_id(self) -> str:
        """The text without the words of the id, for a place that shows the id before it."""
        return self.text.removeprefix(f"{self.id.replace('_', ' ')}: ")

    @property
    def words(self) -> str:
        """Text for a person; the id leads to the row of the fault table."""
        row = self.detector
        parts = (self.vehicle, self.id if row else "", self.after_id if row else self.text)
        return "; ".join([": ".join(filter(None, parts)), *self.notes])


class Intervention(Struct, frozen=True, gc=False, omit_defaults=True):
    """Change of the demanded force by the safety filter."""

    dfx_w: float  # change of the mean force in W [N]
    dfy_w: float  # [N]
    hazard: Hazard  # what it avoids
    name: str = ""  # of the obstacle or vehicle

    @property
    def words(self) -> str:
        """The hazard, for a person."""
        return self.name or self.hazard.words
