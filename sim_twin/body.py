r"""One integration step of a planar rigid body under a time-varying body wrench.

State: position and velocity of the body's origin and heading, x = (x, y, theta, vx, vy, omega) in
W. Newton and Euler hold for the centre of mass, at c in the body, r = R(theta) c from the origin:

    m a_c = R(theta) f(t) + hose + m g(p + r) - (drag + friction) v_c
    I theta'' = tau_c(t) + hose's torque - spin_drag theta'
    a     = a_c - theta'' x r + theta'^2 r             v_c = v + theta' x r

and c, m and I change as gas leaves. The step is the 3-stage Gauss collocation method (order 6). Its
stage equations are solved by fixed-point iteration: thrust, by far the largest term, depends only
on time and heading and is exact in the first pass; tilt and drag contract by about drag h / m per
pass.
With constant torque and no drag the heading is the exact parabola.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sim_twin.ground import friction_at, tilt_at
from testbed.core.compiled import compiled, inlined

Array = NDArray[np.float64]

_R = np.sqrt(15.0)
_C = (0.5 - _R / 10.0, 0.5, 0.5 + _R / 10.0)
_A = (
    (5.0 / 36.0, 2.0 / 9.0 - _R / 15.0, 5.0 / 36.0 - _R / 30.0),
    (5.0 / 36.0 + _R / 24.0, 2.0 / 9.0, 5.0 / 36.0 - _R / 24.0),
    (5.0 / 36.0 + _R / 30.0, 2.0 / 9.0 + _R / 15.0, 5.0 / 36.0),
)
_B = (5.0 / 18.0, 4.0 / 9.0, 5.0 / 18.0)
_AA = tuple(tuple(sum(_A[i][k] * _A[k][j] for k in range(3)) for j in range(3)) for i in range(3))
_BB = tuple(_B[i] * (1.0 - _C[i]) for i in range(3))

C, A, B = np.array(_C), np.array(_A), np.array(_B)
AA, BB = np.array(_AA), np.array(_BB)
PASSES = 12
SMALL = 1e-10  # [m/s^2] end of the iteration: the remaining error is a thousandth of this
FX, FY, TAU, MASS, INERTIA, CX, CY = range(7)  # columns of `Stages.body`


class Stages(NamedTuple):
    """A step at its three Gauss points; work memory that every step overwrites."""

    # wrench about the origin, mass, inertia about the centre of mass, centre of mass in B;
    # shape (3, 7)
    body: Array
    gas: Array  # (3, 2) flow [kg/s] and supply pressure over set pressure
    spin: Array  # (3,) angular acceleration [rad/s^2]
    accel: Array  # (3, 2) of the origin [m/s^2]
    still: Array  # (3, 6) terms constant during the iteration


def no_stages() -> Stages:
    """Work memory of `step`."""
    return Stages(
        np.empty((3, 7)), np.empty((3, 2)), np.empty(3), np.empty((3, 2)), np.empty((3, 6))
    )


new_stages = compiled(no_stages)  # for compiled code


@inlined
def step(x, h, stages, drag, spin_drag, hose, ground):
    """Advance `x`, shape (6,), by `h` in place.

    Args:
        x: state, see the module docstring.
        h: step [s].
        stages: `body` is read; the rest is written to.
        drag: [N s/m].
        spin_drag: [N m s/rad].
        hose: force in W [N] and torque [N m] of a hose, shape (3,).
        ground: the table.
    """
    theta, omega = x[2], x[5]
    body, spin, accel, still = stages.body, stages.spin, stages.accel, stages.still
    spin[:] = 0.0
    accel[:] = 0.0
    for _ in range(PASSES):
        change = 0.0
        for i in range(3):
            w = omega
            for j in range(3):
                w += h * A[i, j] * spin[j]
            cx, cy = body[i, CX], body[i, CY]
            torque = body[i, TAU] - (cx * body[i, FY] - cy * body[i, FX]) + hose[2]
            new = (torque - spin_drag * w) / body[i, INERTIA]
            change = max(change, abs(new - spin[i]))
            spin[i] = new
        if spin_drag == 0.0 or change < SMALL:
            break
    for i in range(3):  # r, w, drag / m, acceleration by jets and spin
        angle, w = theta + C[i] * h * omega, omega
        for j in range(3):
            angle += h * h * AA[i, j] * spin[j]
            w += h * A[i, j] * spin[j]
        cos, sin = np.cos(angle), np.sin(angle)
        fx, fy, mass = body[i, FX], body[i, FY], body[i, MASS]
        rx = cos * body[i, CX] - sin * body[i, CY]
        ry = sin * body[i, CX] + cos * body[i, CY]
        still[i, 0], still[i, 1], still[i, 2], still[i, 3] = rx, ry, w, drag / mass
        still[i, 4] = (cos * fx - sin * fy + hose[0]) / mass + spin[i] * ry + w * w * rx
        still[i, 5] = (sin * fx + cos * fy + hose[1]) / mass - spin[i] * rx + w * w * ry
    patches = ground.patches.shape[0] > 0
    weak = drag != 0.0 or ground.map.shape[0] > 0 or patches
    for _ in range(PASSES):
        change = 0.0
        for i in range(3):
            rx, ry, w, slow = still[i, 0], still[i, 1], still[i, 2], still[i, 3]
            qx, qy, ux, uy = x[0] + C[i] * h * x[3], x[1] + C[i] * h * x[4], x[3], x[4]
            for j in range(3):
                qx += h * h * AA[i, j] * accel[j, 0]
                qy += h * h * AA[i, j] * accel[j, 1]
                ux += h * A[i, j] * accel[j, 0]
                uy += h * A[i, j] * accel[j, 1]
            gx, gy = tilt_at(ground, qx + rx, qy + ry)
            if patches:
                slow += friction_at(ground, qx, qy, ux, uy)
            new_x = still[i, 4] + gx - slow * (ux - w * ry)
            new_y = still[i, 5] + gy - slow * (uy + w * rx)
            change = max(change, abs(new_x - accel[i, 0]), abs(new_y - accel[i, 1]))
            accel[i, 0], accel[i, 1] = new_x, new_y
        if not weak or change < SMALL:
            break
    x[0] += h * x[3]
    x[1] += h * x[4]
    x[2] += h * x[5]
    for i in range(3):
        x[0] += h * h * BB[i] * accel[i, 0]
        x[1] += h * h * BB[i] * accel[i, 1]
        x[2] += h * h * BB[i] * spin[i]
        x[3] += h * B[i] * accel[i, 0]
        x[4] += h * B[i] * accel[i, 1]
        x[5] += h * B[i] * spin[i]


@inlined
def slide(x, h, grip):
    """Advance `x`, shape (6,), by `h` in place: without bearing air, under dry friction.

    The table's slope is far too small to move a standing vehicle. Friction is applied to sliding
    and turning independently; a real body that does both stops a little later.

    Args:
        x: state, see the module docstring.
        h: step [s].
        grip: deceleration of sliding and turning, shape (2,) [m/s^2, rad/s^2].
    """
    speed = np.sqrt(x[3] * x[3] + x[4] * x[4])
    if speed > 0.0:
        lasts = min(h, speed / grip[0])
        left = max(0.0, 1.0 - grip[0] * h / speed)
        way = lasts * (1.0 - 0.5 * grip[0] * lasts / speed)
        x[0] += way * x[3]
        x[1] += way * x[4]
        x[3] *= left
        x[4] *= left
    spin = abs(x[5])
    if spin > 0.0:
        lasts = min(h, spin / grip[1])
        left = max(0.0, 1.0 - grip[1] * h / spin)
        x[2] += lasts * (1.0 - 0.5 * grip[1] * lasts / spin) * x[5]
        x[5] *= left
