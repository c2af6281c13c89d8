r"""A planar rigid body under a body wrench that is linear in time: one exact-enough step.

State: position and velocity of the body's origin and heading, x = (x, y, theta, vx, vy, omega) in
W. The equations of motion hold for the centre of mass c, which moves in the body as gas leaves:

    m c'' = R(theta) f(t) + m g(c) - drag c'      I theta'' = tau_c(t) - spin_drag theta'

The step is the 3-stage Gauss collocation method (order 6). Its stage equations are solved by
iteration: thrust, by far the largest term, depends on time and heading only and is exact in the
first pass; tilt and drag are small and contract by about drag h / m per pass. With constant torque
and no drag the heading is the exact parabola.
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


@compiled
def step(x, h, value, slope, mass, inertia, com, drag, spin_drag, ground):
    """Advance `x`, shape (6,), by `h` in place.

    Args:
        x: see the module's first lines.
        h: [s].
        value: body wrench about the origin at the start, (fx, fy, tau).
        slope: its rate of change.
        mass: [kg].
        inertia: about the centre of mass [kg m^2].
        com: centre of mass in B, (2,) [m].
        drag: [N s/m].
        spin_drag: [N m s/rad].
        ground: the table.
    """
    cx, cy = com[0], com[1]
    c, s = np.cos(x[2]), np.sin(x[2])
    rx, ry = c * cx - s * cy, s * cx + c * cy
    px, py, theta = x[0] + rx, x[1] + ry, x[2]
    vx, vy, omega = x[3] - x[5] * ry, x[4] + x[5] * rx, x[5]
    twist0 = value[2] - (cx * value[1] - cy * value[0])
    twist1 = slope[2] - (cx * slope[1] - cy * slope[0])
    ax, ay, spin = np.zeros(3), np.zeros(3), np.zeros(3)
    weak = drag != 0.0 or spin_drag != 0.0 or ground.map.shape[0] > 0
    for _ in range(PASSES if weak else 2):
        change = 0.0
        for i in range(3):
            t = C[i] * h
            w = omega
            for j in range(3):
                w += h * A[i, j] * spin[j]
            new = (twist0 + t * twist1 - spin_drag * w) / inertia
            change = max(change, abs(new - spin[i]))
            spin[i] = new
        for i in range(3):
            t = C[i] * h
            angle = theta + t * omega
            qx, qy, ux, uy = px + t * vx, py + t * vy, vx, vy
            for j in range(3):
                angle += h * h * AA[i, j] * spin[j]
                qx += h * h * AA[i, j] * ax[j]
                qy += h * h * AA[i, j] * ay[j]
                ux += h * A[i, j] * ax[j]
                uy += h * A[i, j] * ay[j]
            gx, gy = tilt_at(ground, qx, qy)
            fx, fy = value[0] + t * slope[0], value[1] + t * slope[1]
            cos, sin = np.cos(angle), np.sin(angle)
            new_x = (cos * fx - sin * fy - drag * ux) / mass + gx
            new_y = (sin * fx + cos * fy - drag * uy) / mass + gy
            change = max(change, abs(new_x - ax[i]), abs(new_y - ay[i]))
            ax[i], ay[i] = new_x, new_y
        if change < 1e-15:
            break
    px += h * vx
    py += h * vy
    theta += h * omega
    for i in range(3):
        px += h * h * BB[i] * ax[i]
        py += h * h * BB[i] * ay[i]
        theta += h * h * BB[i] * spin[i]
        vx += h * B[i] * ax[i]
        vy += h * B[i] * ay[i]
        omega += h * B[i] * spin[i]
    c, s = np.cos(theta), np.sin(theta)
    rx, ry = c * cx - s * cy, s * cx + c * cy
    x[0], x[1], x[2] = px - rx, py - ry, theta
    x[3], x[4], x[5] = vx + omega * ry, vy - omega * rx, omega
