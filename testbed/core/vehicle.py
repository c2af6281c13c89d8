"""A vehicle as in its file: mass, jets, valves and air; other modules take them from here.

The allocator and the twin read the same numbers. Uncertain values (thrust spread, nozzle alignment
etc.) have a tolerance; the twin draws its true vehicle from it, and the flight chain never sees the
draw.
"""

from typing import Annotated

from msgspec import Meta, Struct

Positive = Annotated[float, Meta(gt=0.0)]
NonNegative = Annotated[float, Meta(ge=0.0)]
Point = tuple[float, float]


class Jet(Struct, frozen=True, forbid_unknown_fields=True):
    """One nozzle behind one on/off valve."""

    position: Point  # in B [m]
    push: Point  # unit vector in B: direction of the force on the body, opposite to the plume
    thrust: Positive  # at the regulator's set pressure, this valve alone open [N]


class Valve(Struct, frozen=True, forbid_unknown_fields=True):
    """Timing shared by all valves of a vehicle.

    The board refuses pulses shorter than `min_on_s` and delays a re-opening until `min_off_s` has
    passed. Flow starts `open_delay_s` after the opening command and rises linearly; it starts to
    fall `close_delay_s` after the closing command.
    """

    open_delay_s: NonNegative
    close_delay_s: NonNegative
    open_ramp_s: NonNegative
    close_ramp_s: NonNegative
    min_on_s: NonNegative
    min_off_s: NonNegative


LOWEST_SHARE = 0.1  # of the set pressure: plans, brakes and margins count on no less


class Air(Struct, frozen=True, forbid_unknown_fields=True):
    """Gas supply: tank, regulator, manifold."""

    gas: Positive  # in the full tank [kg]
    tank_pressure: Positive  # full [Pa]
    tank_position: Point  # in B [m]
    set_pressure: Positive  # regulator [Pa]
    dropout: NonNegative  # tank pressure must exceed supply pressure by this [Pa]
    exhaust_speed: Positive  # thrust / mass flow [m/s]
    droop: NonNegative  # k: thrust of each of n open jets is thrust / (1 + k (n - 1))
    bearing_flow: NonNegative  # [kg/s]

    def supply_pressure(self, gas: float) -> float:
        """Pressure behind the regulator with `gas` kg left, isothermal tank [Pa]."""
        return max(0.0, min(self.set_pressure, self.pressure_in_tank(gas) - self.dropout))

    def pressure_in_tank(self, gas: float) -> float:
        """Pressure in the tank with `gas` kg left, isothermal ideal gas [Pa]."""
        return self.tank_pressure * max(0.0, gas) / self.gas


class Tolerance(Struct, frozen=True, forbid_unknown_fields=True):
    """Standard deviations of the real vehicle from its file."""

    thrust: NonNegative  # per jet, relative
    direction_deg: NonNegative  # nozzle alignment
    pulse: NonNegative  # pulse to pulse, relative
    mass: NonNegative  # relative
    inertia: NonNegative  # relative
    com: NonNegative  # centre of mass, each axis [m]


class Gauges(Struct, frozen=True, forbid_unknown_fields=True):
    """Sensors of the valve board.

    A declared sensor that reads 0 fails the arming checks: no air, no battery, or a broken wire. A
    sensor that is not declared is not checked.
    """

    supply: bool = True  # pressure behind the regulator
    battery: bool = True  # voltage of the valves' supply
    battery_v: Positive = 12.0  # nominal; without a sensor it is taken to be this [V]
    undervoltage_v: NonNegative = 0.0  # the board shuts all valves below this; 0: never [V]


class Landing(Struct, frozen=True, forbid_unknown_fields=True):
    """Bearing air when commands stop: `testbed.core.landing` computes from it when the board lands.

    Jets that hear nothing shut, so the vehicle drifts; without bearing air it stops.
    """

    by_board: bool = True  # false: the board keeps the air on
    speed: Positive = 0.2  # fastest flight [m/s]
    slope: NonNegative = 0.005  # steepest acceleration by the table's tilt [m/s^2]
    room: NonNegative = 0.05  # free way in every direction, also at this speed [m]
    # coefficient of the vehicle without bearing air: graphite pads on polished granite have 0.1 to
    # 0.2, and the lower value slides farther [assumed]
    friction: Positive = 0.1


class Vehicle(Struct, frozen=True, forbid_unknown_fields=True):
    """One air-bearing vehicle."""

    mass: Positive  # with a full tank [kg]
    inertia: Positive  # about the vertical through the centre of mass [kg m^2]
    com: Point  # centre of mass in B with a full tank [m]
    radius: Positive  # of the disc that encloses it [m]
    command_delay_s: NonNegative  # from issuing a plan to its start on the board
    drag: NonNegative  # bearing, viscous [N s/m]
    spin_drag: NonNegative  # [N m s/rad]
    jets: list[Jet]
    valve: Valve
    air: Air
    tolerance: Tolerance
    gauges: Gauges = Gauges()
    landing: Landing = Landing()
