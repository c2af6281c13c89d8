"""Flying by hand: a stick moves a reference model, which the vehicle tracks.

The model is a double integrator with the force that guidance gives to laws. With a velocity stick
its speed goes to the stick's as fast as the force allows. With a force stick the force is the
stick's, up to the top speed. Without fresh stick messages it comes to rest, and stays there.

The force passes the safety filter here, as that of any reference model, and the vehicle's own
filter, fence and gate afterwards.
"""

import math
from collections.abc import Mapping

from testbed.core.rows import References
from testbed.core.se2 import wrap
from testbed.core.types import (
    Intervention,
    State,
    Stick,
    Trajectory,
)
from testbed.core.vehicle import Vehicle
from testbed.flight.allocation import weakest_force
from testbed.flight.barrier import Barrier
from testbed.flight.guidance import GuidanceParams
from testbed.flight.turn import TURN_ACCEL

STOP_M = 0.25  # distance within which the top speed can be stopped
FASTEST = 0.8  # of the speed above which filter or gate intervene
TURN = 0.25  # largest turn rate [rad/s]
ASTRAY_M = 0.3  # a model this far from its vehicle begins anew, at the vehicle

Motion = tuple[float, float, float, float, float, float]  # x, y, theta and their rates


def nearer(value: float, wanted: float, step: float) -> float:
    """`value`, moved towards `wanted` by `step` at most."""
    return wanted if abs(wanted - value) <= step else value + math.copysign(step, wanted - value)


class Pilot:
    """Flies one vehicle by hand.

    Args:
        params: of guidance: share of the force, preview and life of references.
        vehicle: to fly.
        period: of the jets [s].
        speed: above which filter or gate intervene [m/s].
        barrier: filters the force on the model; None: switched off.
    """

    def __init__(
        self, params: GuidanceParams, vehicle: Vehicle, period: float, speed: float,
        barrier: Barrier | None = None,
    ) -> None:  # fmt: skip
        self._mass, self._period, self._barrier = vehicle.mass, period, barrier
        self._accel = params.force_share * weakest_force(vehicle) / vehicle.mass
        self.top_speed = min(math.sqrt(2.0 * self._accel * STOP_M), FASTEST * speed)  # [m/s]
        self._ahead = 1 + math.ceil(params.preview_s / period - 1e-9)
        self._life = params.setpoint_life_s
        self._motion: Motion = (0.0,) * 6  # of the model at the next tick
        self.flies = False
        self.filtered: Intervention | None = None  # of the newest reference

    def step(
        self, t: float, own: State, stick: Stick, neighbours: Mapping[str, State]
    ) -> Trajectory:
        """References from `t` on, one a period; the stick is taken as held.

        Args:
            t: one period after the last step's, if that was the last tick [s].
            own: newest estimate of the vehicle.
            stick: of the operator.
            neighbours: newest state of each other vehicle.
        """
        motion, h = self._motion, self._period
        late, pose, twist = t - own.t, own.pose, own.twist
        x, y = pose.x + late * twist.vx, pose.y + late * twist.vy
        if not self.flies or math.hypot(motion[0] - x, motion[1] - y) > ASTRAY_M:
            motion = (x, y, pose.theta + late * twist.omega, twist.vx, twist.vy, twist.omega)
        self.flies = True
        references: list[tuple[float, ...]] = []
        for k in range(self._ahead):
            now = t + k * h
            ax, ay, filtered = self._push(now, motion, stick, neighbours)
            x, y, theta, vx, vy, omega = motion
            wanted = TURN * stick.turn if stick.alive else 0.0
            alpha = (nearer(omega, wanted, TURN_ACCEL * h) - omega) / h
            references.append((now, x, y, theta, vx, vy, omega, ax, ay, alpha))
            motion = (
                x + h * (vx + 0.5 * h * ax), y + h * (vy + 0.5 * h * ay),
                wrap(theta + h * (omega + 0.5 * h * alpha)),
                vx + h * ax, vy + h * ay, omega + h * alpha,
            )  # fmt: skip
            if k == 0:
                self._motion, self.filtered = motion, filtered
        return Trajectory(References.from_numbers(references), references[-1][0] + self._life)

    def _push(
        self, t: float, motion: Motion, stick: Stick, neighbours: Mapping[str, State]
    ) -> tuple[float, float, Intervention | None]:
        """Acceleration of the model over the coming period, and the filter's change."""
        x, y, _, vx, vy, _ = motion
        ax, ay = self._asked(vx, vy, stick)
        if self._barrier is None:
            return ax, ay, None
        force = (self._mass * ax, self._mass * ay)
        fx, fy, filtered = self._barrier.filter(t, force, (x, y, vx, vy, 0.0, 0.0), neighbours)
        return fx / self._mass, fy / self._mass, filtered

    def _asked(self, vx: float, vy: float, stick: Stick) -> tuple[float, float]:
        """Acceleration that the stick asks for, within force and top speed."""
        h, size = self._period, max(1.0, math.hypot(stick.x, stick.y))
        sx, sy = stick.x / size, stick.y / size
        if stick.alive and stick.pushes:
            wx, wy = vx + h * self._accel * sx, vy + h * self._accel * sy
            over = max(1.0, math.hypot(wx, wy) / self.top_speed)
            wx, wy = wx / over, wy / over
        else:
            top = self.top_speed if stick.alive else 0.0
            wx, wy = top * sx, top * sy
        ax, ay = (wx - vx) / h, (wy - vy) / h
        over = max(1.0, math.hypot(ax, ay) / self._accel)
        return ax / over, ay / over
