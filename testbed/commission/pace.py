"""How long a jet may push, and how long a vehicle may float: no vehicle gets fast."""

from testbed.commission.jets import flow_times
from testbed.core.vehicle import Vehicle

FASTEST = 0.05  # no vehicle may be faster during a commissioning [m/s]
STOP = 0.033  # expected to get faster than this, it loses its bearing air [m/s]
PROBE = 0.003  # change of speed by the first pulse of a jet, by the file [m/s]
PUSH = 0.012  # change of speed by the pulse that is measured [m/s]
LONGEST = 0.3  # pulse [s]
SHORTEST = 0.02  # pulse, or the valve's shortest [s]


def pulse_length(vehicle: Vehicle, jet: int, change: float, stronger: float = 1.0) -> float:
    """Open time for a change of speed [s].

    Args:
        vehicle: as in its file.
        jet: from 0.
        change: of speed [m/s].
        stronger: thrust of this jet beside the file's, as the last pulse showed.
    """
    thrust = vehicle.jets[jet].thrust * max(1.0, stronger)
    _, extra = flow_times(vehicle, 0.5)  # flow of an opening of 0.5 s
    wanted = change * vehicle.mass / thrust - (extra - 0.5)
    return min(max(wanted, SHORTEST, vehicle.valve.min_on_s), LONGEST)


def float_time(accel: float, longest: float) -> float:
    """Time in which a vehicle at rest gets at most a quarter as fast as it may [s]."""
    return min(longest, 0.25 * FASTEST / max(accel, 1e-6))


def drags_of(vehicle: Vehicle) -> tuple[float, float]:
    """Deceleration over speed, of motion and of turning [1/s]."""
    return vehicle.drag / vehicle.mass, vehicle.spin_drag / vehicle.inertia
