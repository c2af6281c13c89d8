"""The nouns: everything that passes between the parts of the stack, goes on the wire or in the log.

SI units and radians. One quantity, one frame: pose and twist are in the table frame W (origin at
the table's centre, x right, y up, theta counter-clockwise), a wrench is in the body frame B. Where
a quantity leaves its usual frame, its name says so (`force_w`).

All are frozen: a value handed over is never changed behind anyone's back. A frozen value cannot be
part of a cycle, so none is known to the garbage collector (`gc=False`): a flight makes half a
million of them.
"""

from msgspec import Struct


class Pose(Struct, frozen=True, gc=False):
    """Position and heading in W."""

    x: float  # [m]
    y: float  # [m]
    theta: float  # [rad]


class Twist(Struct, frozen=True, gc=False):
    """Velocity and turn rate in W."""

    vx: float  # [m/s]
    vy: float  # [m/s]
    omega: float  # [rad/s]


class Accel(Struct, frozen=True, gc=False):
    """Acceleration and angular acceleration in W."""

    ax: float  # [m/s^2]
    ay: float  # [m/s^2]
    alpha: float  # [rad/s^2]


class Wrench(Struct, frozen=True, gc=False):
    """Force and torque in B, about the body's origin."""

    fx: float  # [N]
    fy: float  # [N]
    tau: float  # [N m]


class PoseSample(Struct, frozen=True, gc=False, array_like=True):
    """One rigid body in one motion-capture frame."""

    captured_at: float  # middle of the exposure [s]
    x: float  # [m]
    y: float  # [m]
    theta: float  # [rad]


class State(Struct, frozen=True, gc=False):
    """What a satellite believes about itself at time `t`."""

    t: float  # [s]
    pose: Pose
    twist: Twist
    bias: Accel  # acceleration that the commanded jets do not explain
    pose_age: float  # since the newest accepted sample was captured [s]
    rejected: int  # samples the outlier gate has refused of late; see flight/estimator.py


class Reference(Struct, frozen=True, gc=False, tag=True):
    """Where to be at time `t`, and how to accelerate during the jet period that follows."""

    t: float  # [s]
    pose: Pose
    twist: Twist
    accel: Accel


class Trajectory(Struct, frozen=True, gc=False, tag=True):
    """References for the coming jet periods: a lost message costs nothing while they last."""

    references: tuple[Reference, ...]  # in order of time, at least one
    valid_until: float  # worth nothing afterwards [s]


class Demand(Struct, frozen=True, gc=False, tag=True):
    """A mean force for the jet period that starts at `t`, and the heading to hold meanwhile.

    The heading loop closes on the vehicle also when the law that asks for the force does not.
    """

    t: float  # [s]
    fx_w: float  # force in W [N]
    fy_w: float  # [N]
    theta: float  # [rad]
    omega: float  # [rad/s]
    alpha: float  # [rad/s^2]
    valid_until: float  # worth nothing afterwards [s]


Setpoint = Trajectory | Demand


class ValveCommand(Struct, frozen=True, gc=False):
    """A complete plan for one jet period: one pulse at most per valve.

    A plan replaces the one before when it starts, and it ends by itself: after `valid_until`
    every valve is closed, whatever became of the sender.
    """

    seq: int
    issued_at: float  # [s]
    valid_until: float  # [s]
    on_us: tuple[int, ...]  # open time per valve [us]
    offset_us: tuple[int, ...]  # from the plan's start to the opening command [us]


class LawMessage(Struct, frozen=True, gc=False):
    """What a vehicle's law says to the laws of the others."""

    t: float  # what it is for [s]
    values: tuple[float, ...]  # by the law's own convention, in the law's own units


class Health(Struct, frozen=True, gc=False, omit_defaults=True):
    """What the board reports of itself."""

    t: float  # board's time [s]
    supply_pressure: float  # behind the regulator [Pa]
    tank_pressure: float  # [Pa]
    battery: float = 12.0  # [V]
    silent_s: float = 0.0  # since the board last answered [s]


class Vitals(Struct, frozen=True, gc=False, omit_defaults=True):
    """What the process round a vehicle's chain knows of itself, the network and the operator.

    The defaults are what it is when all is well: a rig fills in what it can tell.
    """

    session_ok: bool = True  # setpoints are of the session that armed the vehicle
    operator_age: float = 0.0  # since the operator's presence was last heard [s]
    clock_offset: float = 0.0  # the host's clock minus the vehicle's [s]
    late_s: float = 0.0  # how long after its time this tick began [s]
    disk_free: float = 1e12  # where the log goes [bytes]
    same_config: bool = True  # host and vehicle have the same configuration hash
    law_error: str = ""  # what the law on the host died of
    fleet: str = ""  # a fault of another vehicle that stops all
    foreign: int = 0  # messages of another session since the last tick; none was obeyed
    end: str = ""  # why the flight is over: come to rest and shut the air off


ALL_WELL = Vitals()


class Intervention(Struct, frozen=True, gc=False):
    """What the safety filter made of the demanded force."""

    dfx_w: float  # change of the mean force in W [N]
    dfy_w: float  # [N]
    because: str  # what it kept the vehicle away from


class Inputs(Struct, frozen=True, gc=False, omit_defaults=True):
    """All that a satellite is told between two ticks. With `Outputs` it makes a run replayable."""

    t: float  # [s]
    armed: bool
    samples: tuple[PoseSample, ...]  # arrived since the last tick, in order of arrival
    setpoint: Setpoint | None  # the newest one heard, however old
    neighbours: dict[str, State]  # the newest one heard of each, however old
    health: Health
    messages: dict[str, LawMessage] = {}  # by the laws of the others, the newest of each
    vitals: Vitals = ALL_WELL


class Outputs(Struct, frozen=True, gc=False, omit_defaults=True):
    """All that a satellite does in one tick."""

    t: float  # [s]
    state: State | None  # None before the first pose
    active_setpoint: Reference | Demand | None  # what the tracker was given
    commanded_wrench: Wrench  # what tracker or law asks for, mean over the period
    realised_wrench: Wrench  # what the pulses of `command` give, by the vehicle's jet table
    command: ValveCommand
    inhibit_reason: str | None = None  # the gate's reason, None while it is open
    fault: str | None = None  # a reason that ends the run, latched
    message: LawMessage | None = None  # by its law, if that runs on board and talks
    faults: tuple[str, ...] = ()  # ids of all rows of the fault table that hold now
    response: str = ""  # the most severe response in force; empty: none
    filtered: Intervention | None = None  # None: the demand was left as it was
    air_off: bool = False  # shut the bearing air off: nothing flies on from here


class Tick(Struct, frozen=True, gc=False):
    """One vehicle's tick, whole: what replay feeds in and compares."""

    inputs: Inputs
    outputs: Outputs


class EndingTick(Tick, frozen=True, gc=False):
    """A tick after the end of the flight: what is measured of the flight leaves it out."""


class HostInputs(Struct, frozen=True, gc=False, omit_defaults=True):
    """All that the host's half of one satellite knows at a tick: newest heard, however old."""

    t: float  # [s]
    own: State | None
    neighbours: dict[str, State]
    messages: dict[str, LawMessage] = {}  # by the laws of the others


class HostOutputs(Struct, frozen=True, gc=False, omit_defaults=True):
    """The host's answer."""

    t: float  # [s]
    setpoint: Setpoint | None
    message: LawMessage | None = None  # by the law, if it talks
    law_error: str = ""  # what the law died of
    filtered: Intervention | None = None  # of the reference model's force


class HostTick(Struct, frozen=True, gc=False):
    """One tick of a law on the host, whole."""

    inputs: HostInputs
    outputs: HostOutputs
