"""Data types that pass between the parts of the stack, over the network and into the log.

SI units and radians. One quantity, one frame: pose and twist are in the table frame W (origin at
the table's centre, x right, y up, theta counter-clockwise), a wrench is in the body frame B. Where
a quantity is not in its usual frame, its name has the frame (`force_w`).

All are frozen: a value that is passed on never changes. A frozen value cannot be part of a cycle,
so the garbage collector does not track it (`gc=False`): a flight creates half a million of them.
"""

from collections.abc import Sequence

from msgspec import Struct

from testbed.core.codes import FaultReport, Intervention, Refusal, Response


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
    """A satellite's estimate of its own state at time `t`."""

    t: float  # [s]
    pose: Pose
    twist: Twist
    bias: Accel  # acceleration that the commanded jets do not explain
    pose_age: float  # since the newest accepted sample was captured [s]
    rejected: int  # samples that the outlier gate refused recently; see flight/estimator.py


class Reference(Struct, frozen=True, gc=False, tag=True):
    """Desired motion at time `t`, and the acceleration during the following jet period."""

    t: float  # [s]
    pose: Pose
    twist: Twist
    accel: Accel


class Trajectory(Struct, frozen=True, gc=False, tag=True):
    """References for the coming jet periods: they bridge lost messages."""

    references: Sequence[Reference]  # in order of time, at least one
    valid_until: float  # not used afterwards [s]


class Demand(Struct, frozen=True, gc=False, tag=True):
    """A mean force for the jet period that starts at `t`, and the heading to hold meanwhile.

    The heading loop closes on the vehicle, also if the loop of the law closes on the host.
    """

    t: float  # [s]
    fx_w: float  # force in W [N]
    fy_w: float  # [N]
    theta: float  # [rad]
    omega: float  # [rad/s]
    alpha: float  # [rad/s^2]
    valid_until: float  # not used afterwards [s]


Setpoint = Trajectory | Demand


class ValveCommand(Struct, frozen=True, gc=False):
    """A complete plan for one jet period: one pulse at most per valve.

    A plan replaces the previous one when it starts, and it expires: after `valid_until` every valve
    is closed, also if the sender has failed.
    """

    seq: int
    issued_at: float  # [s]
    valid_until: float  # [s]
    on_us: tuple[int, ...]  # open time per valve [us]
    offset_us: tuple[int, ...]  # from the plan's start to the opening command [us]


class LawMessage(Struct, frozen=True, gc=False):
    """Message of a vehicle's law to the laws of the others."""

    t: float  # time for which it is valid [s]
    values: tuple[float, ...]  # by the law's own convention, in the law's own units


class Health(Struct, frozen=True, gc=False, omit_defaults=True):
    """The valve board's report."""

    t: float  # board's time [s]
    supply_pressure: float  # behind the regulator [Pa]
    tank_pressure: float  # [Pa]
    battery: float = 12.0  # [V]
    silent_s: float = 0.0  # since the board last answered [s]


class Vitals(Struct, frozen=True, gc=False, omit_defaults=True):
    """Data about a vehicle's process, the network and the operator.

    The defaults mean that all is in order: a rig fills in the data that it has.
    """

    session_ok: bool = True  # setpoints are of the session that armed the vehicle
    operator_age: float = 0.0  # since the operator's presence was last heard [s]
    clock_offset: float = 0.0  # the host's clock minus the vehicle's [s]
    # delay of this tick's start [s]; more than the share detectors.SPOILT of a jet period if the
    # valves did not play a plan
    late_s: float = 0.0
    disk_free: float = 1e12  # on the disk of the log [bytes]
    same_config: bool = True  # host and vehicle have the same configuration hash
    law_error: str = ""  # exception of the law on the host
    fleet: FaultReport | None = None  # a fault of another vehicle that stops all
    foreign: int = 0  # messages of another session since the last tick; none was obeyed
    end: bool = False  # the flight is over: come to rest and turn the air off


ALL_WELL = Vitals()


class Inputs(Struct, frozen=True, gc=False, omit_defaults=True):
    """All inputs of a satellite at a tick. With `Outputs` they make a run replayable."""

    t: float  # [s]
    armed: bool
    samples: Sequence[PoseSample]  # arrived since the last tick, in order of arrival
    setpoint: Setpoint | None  # the newest one, of any age
    neighbours: dict[str, State]  # the newest one of each, of any age
    health: Health
    messages: dict[str, LawMessage] = {}  # newest message of each other vehicle's law
    vitals: Vitals = ALL_WELL


class Outputs(Struct, frozen=True, gc=False, omit_defaults=True):
    """All outputs of a satellite at a tick."""

    t: float  # [s]
    state: State | None  # None before the first pose
    active_setpoint: Reference | Demand | None  # input of the tracker
    commanded_wrench: Wrench  # demanded by tracker or law, mean over the period
    realised_wrench: Wrench  # mean wrench of the jets, with droop and bad jets
    command: ValveCommand
    inhibit_reason: Refusal | None = None  # why valves stay shut; None: they may open
    fault: FaultReport | None = None  # ends the run, latched
    message: LawMessage | None = None  # message of its law, if it runs on board and sends one
    faults: tuple[str, ...] = ()  # ids of all rows of the fault table that hold now
    response: Response = Response.NONE  # the most severe active one
    filtered: Intervention | None = None  # None: the demand was not changed
    air_off: bool = False  # turn the bearing air off for good


class Tick(Struct, frozen=True, gc=False):
    """One vehicle's complete tick, as used by replay."""

    inputs: Inputs
    outputs: Outputs

    @property
    def t(self) -> float:
        """Time of the tick [s]."""
        return self.inputs.t

    @property
    def ended(self) -> bool:
        """Whether the flight was over."""
        return self.inputs.vitals.end

    @property
    def shut(self) -> bool:
        """Whether the valves had to stay shut."""
        return self.outputs.inhibit_reason is not None

    @property
    def fault(self) -> FaultReport | None:
        """The fault that ends the run."""
        return self.outputs.fault


class EndingTick(Tick, frozen=True, gc=False):
    """A tick after the end of the flight; metrics of the flight ignore it."""


class Stick(Struct, frozen=True, gc=False):
    """How an operator flies a vehicle by hand; all values are shares of the largest, -1 to 1."""

    pushes: bool  # True: x and y are a force in W; False: a velocity in W
    x: float
    y: float
    turn: float  # turn rate, counter-clockwise
    alive: bool  # False: no fresh message; the vehicle comes to rest and holds


class HostInputs(Struct, frozen=True, gc=False, omit_defaults=True):
    """All inputs of a satellite's law on the host at a tick: the newest data, of any age."""

    t: float  # [s]
    own: State | None
    neighbours: dict[str, State]
    messages: dict[str, LawMessage] = {}  # newest message of each other vehicle's law
    stick: Stick | None = None  # None: the law flies


class HostOutputs(Struct, frozen=True, gc=False, omit_defaults=True):
    """All outputs of a law on the host at a tick."""

    t: float  # [s]
    setpoint: Setpoint | None
    message: LawMessage | None = None  # message of the law, if it sends one
    fault: FaultReport | None = None  # of the law
    filtered: Intervention | None = None  # change of the reference model's force


class HostTick(Struct, frozen=True, gc=False):
    """A complete tick of a law on the host."""

    inputs: HostInputs
    outputs: HostOutputs

    @property
    def t(self) -> float:
        """Time of the tick [s]."""
        return self.inputs.t

    @property
    def own_t(self) -> float | None:
        """Time of the vehicle's newest state [s]; None: there is none."""
        return None if self.inputs.own is None else self.inputs.own.t

    @property
    def fault(self) -> FaultReport | None:
        """Fault of the law."""
        return self.outputs.fault
