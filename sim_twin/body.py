r"""A planar rigid body under a body wrench that changes in time: one exact-enough step.

State: position and velocity of the body's origin and heading, x = (x, y, theta, vx, vy, omega) in
W. Newton and Euler hold for the centre of mass, at c in the body, r = R(theta) c from the origin:

    m a_c = R(theta) f(t) + m g(p + r) - drag v_c      I theta'' = tau_c(t) - spin_drag theta'
    a     = a_c - theta'' x r + theta'^2 r             v_c = v + theta' x r

and c, m and I change as gas leaves. The step is the 3-stage Gauss collocation method (order 6). Its
stage equations are solved by iteration: thrust, by far the largest term, depends on time and
heading only and is exact in the first pass; tilt and drag contract by about drag h / m per pass.
With constant torque and no drag the heading is the exact parabola.
"""

import numpy as np

from sim_twin.ground import tilt_at
from testbed.core.compiled import compiled

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
SMALL = 1e-12  # [m/s^2] a pass that changes less leaves a thousandth of it
FX, FY, TAU, MASS, INERTIA, CX, CY = range(7)  # columns of `stages`


@compiled
def step(x, h, stages, drag, spin_drag, ground):
    """Advance `x`, shape (6,), by `h` in place.

    Args:
        x: see the module's first lines.
        h: [s].
        stages: what the body is at the three Gauss points of the step, shape (3, 7): body wrench
            about the origin, mass, inertia about the centre of mass, centre of mass in B.
        drag: [N s/m].
        spin_drag: [N m s/rad].
        ground: the table.
    """
    theta, omega = x[2], x[5]
    ax, ay, spin = np.zeros(3), np.zeros(3), np.zeros(3)
    for _ in range(PASSES):
        change = 0.0
        for i in range(3):
            w = omega
            for j in range(3):
                w += h * A[i, j] * spin[j]
            cx, cy = stages[i, CX], stages[i, CY]
            torque = stages[i, TAU] - (cx * stages[i, FY] - cy * stages[i, FX])
            new = (torque - spin_drag * w) / stages[i, INERTIA]
            change = max(change, abs(new - spin[i]))
            spin[i] = new
        if spin_drag == 0.0 or change < SMALL:
            break
    still = np.empty((3, 6))  # no pass changes: r, w, drag / m, acceleration by jets and spin
    for i in range(3):
        angle, w = theta + C[i] * h * omega, omega
        for j in range(3):
            angle += h * h * AA[i, j] * spin[j]
            w += h * A[i, j] * spin[j]
        cos, sin = np.cos(angle), np.sin(angle)
        fx, fy, mass = stages[i, FX], stages[i, FY], stages[i, MASS]
        rx = cos * stages[i, CX] - sin * stages[i, CY]
        ry = sin * stages[i, CX] + cos * stages[i, CY]
        still[i, 0], still[i, 1], still[i, 2], still[i, 3] = rx, ry, w, drag / mass
        still[i, 4] = (cos * fx - sin * fy) / mass + spin[i] * ry + w * w * rx
        still[i, 5] = (sin * fx + cos * fy) / mass - spin[i] * rx + w * w * ry
    weak = drag != 0.0 or ground.map.shape[0] > 0
    for _ in range(PASSES):
        change = 0.0
        for i in range(3):
            rx, ry, w, slow = still[i, 0], still[i, 1], still[i, 2], still[i, 3]
            qx, qy, ux, uy = x[0] + C[i] * h * x[3], x[1] + C[i] * h * x[4], x[3], x[4]
            for j in range(3):
                qx += h * h * AA[i, j] * ax[j]
                qy += h * h * AA[i, j] * ay[j]
                ux += h * A[i, j] * ax[j]
                uy += h * A[i, j] * ay[j]
            gx, gy = tilt_at(ground, qx + rx, qy + ry)
            new_x = still[i, 4] + gx - slow * (ux - w * ry)
            new_y = still[i, 5] + gy - slow * (uy + w * rx)
            change = max(change, abs(new_x - ax[i]), abs(new_y - ay[i]))
            ax[i], ay[i] = new_x, new_y
        if not weak or change < SMALL:
            break
    x[0] += h * x[3]
    x[1] += h * x[4]
    x[2] += h * x[5]
    for i in range(3):
        x[0] += h * h * BB[i] * ax[i]
        x[1] += h * h * BB[i] * ay[i]
        x[2] += h * h * BB[i] * spin[i]
        x[3] += h * B[i] * ax[i]
        x[4] += h * B[i] * ay[i]
        x[5] += h * B[i] * spin[i]
