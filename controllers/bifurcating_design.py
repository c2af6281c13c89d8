r"""Fields of the bifurcating law for a few vehicles on a table, from their number, mass and force.

The paper (see `controllers.bifurcating`) chooses its gains for fifty satellites of 100 kg over
kilometres and does not say how. This design is ours, not the paper's: every vehicle can push with
`force` F in its weakest direction, and the design divides F between damping and repulsion.

    speed       v*  = sqrt(0.1 D F/m), limited to 0.04..0.15 m/s; D = 2 m is a typical distance
    damping     k_v = 0.8 F/v*: at v* the damping takes 0.8 of the force, so the formation force
                      is limited to k_v v* and the speed stays near or below v*
    stiffness   K   = k_v^2/(4 zeta^2 m), normal to the curve, zeta = 0.5, k_f = K/|mu|; on an
                      ellipse, where |grad q| goes from b at the ends of the long axis to a = 1,
                      k_f = K/(b |mu|), which gives b K to K/b
    repulsion   k_c = 1.2 F/(s - 0.55 m): two vehicles 0.55 m apart repel each other with 1.2 F,
                      more than their thrusters give
    range       s   a little more than the spacing on a circle, so that the ring is evenly spaced
                      (the paper's s = r is less than the spacing for fewer than seven), a little
                      less on other curves; more than the spacing on the double line, so that a
                      line splits in two: an exact line has no reason to split without it
    radius      r   reduced by the offset that the repulsion causes, so that the ring has the
                      intended radius

The curves fit a table of 6 m x 6 m with vehicles of 0.2 m radius: circle of 1.5 m, line along x,
two lines 0.75 m either side of it, ellipses of 2.0 m x 1.2 m and (flat) 2.35 m x 0.705 m.
"""

import math
from typing import Annotated, Literal

import numpy as np
from msgspec import Meta, Struct
from numpy.typing import NDArray

from testbed.core.error import MismatchError
from testbed.core.vehicle import NonNegative, Positive

Array = NDArray[np.float64]

Shape = Literal["circle", "line", "double_line", "ellipse", "flat"]

WAY = 2.0  # D [m]
SLOWEST, FASTEST = 0.04, 0.15  # v* [m/s]
SHARE = 0.8  # of the force for the formation
DAMPING = 0.5  # zeta
DEEP = -3.0  # mu of a single curve, so that rho |rho| is small compared with mu rho [m]
CLOSEST = 0.55  # two vehicles of 0.2 m radius and 0.15 m between them [m]
FURTHEST = 1.92  # range of the repulsion on an ellipse [m]
HALF_LENGTH = 2.55  # of a line: vehicle centres stay 0.45 m from the edge [m]
CROWD = 6  # vehicles from which a line needs a repulsion range above the spacing
RADIUS, OFFSET = 1.5, 0.75  # radius of the circle; offset of the double line's rows [m]
AXES = {"ellipse": (1.0, 0.6, 2.0), "flat": (1.0, 0.3, 2.35)}  # a, b, r [m]


class Fleet(Struct, frozen=True, forbid_unknown_fields=True):
    """The vehicles that a field is designed for."""

    count: Annotated[int, Meta(ge=1)]  # N
    mass: Positive  # [kg]
    force: Positive  # in the weakest direction [N]


class Field(Struct, frozen=True):
    """Parameters of the law for one formation, see `controllers.bifurcating`."""

    a: NonNegative
    b: NonNegative
    mu: float  # [m]
    k_f: Positive  # [N/m^2]
    k_v: NonNegative  # [kg/s]
    k_c: NonNegative = 0.0  # [N/m]
    s: NonNegative = 0.0  # [m]
    r: NonNegative = 0.0  # [m]
    c: Positive | None = None  # if given: a surface in space
    sigma: NonNegative = 0.0  # [m]
    cap: Positive | None = None  # on the formation force [N]


def cruise(fleet: Fleet) -> float:
    """v*, the speed at which the damping balances the formation force [m/s]."""
    return min(max(math.sqrt(0.1 * WAY * fleet.force / fleet.mass), SLOWEST), FASTEST)


def design(fleet: Fleet, shape: Shape) -> Field:
    """The field that forms `shape`."""
    n, speed = fleet.count, cruise(fleet)
    k_v = SHARE * fleet.force / speed
    stiffness = k_v**2 / (4.0 * DAMPING**2 * fleet.mass)

    def field(a: float, b: float, r: float, mu: float, s: float, k_c: float) -> Field:
        k_f = stiffness / (abs(mu) * (b or a))
        return Field(a=a, b=b, mu=mu, k_f=k_f, k_v=k_v, k_c=k_c, s=s, r=r, cap=k_v * speed)

    match shape:
        case "circle":
            s = 1.15 * chord(n) if n > 1 else 0.0
            k_c = _repulsion(fleet, s)
            return field(1.0, 1.0, RADIUS - _push(n, k_c, s) / stiffness, DEEP, s, k_c)
        case "line":
            s = _range_on_line(n)
            k_c = _repulsion(fleet, s)
            if n >= CROWD:  # limit the stiffness: the line would break into two rows
                k_c = min(k_c, 0.8 * stiffness / (4.0 * (s * (n - 1) / (2.0 * HALF_LENGTH) - 1.0)))
            return field(1.0, 0.0, 1.0, DEEP, s, k_c)
        case "double_line":
            s = 1.45
            return field(1.0, 0.0, 1.0, OFFSET, s, _repulsion(fleet, s))
        case "ellipse" | "flat":
            a, b, r = AXES[shape]
            s = min(0.9 * perimeter(a * r, b * r) / n, FURTHEST)
            return field(a, b, r, DEEP, s, _repulsion(fleet, s))


def chord(n: int) -> float:
    """Distance of adjacent vehicles on the circle [m]."""
    return 2.0 * RADIUS * math.sin(math.pi / n)


def perimeter(a: float, b: float) -> float:
    """Perimeter of an ellipse with these semi-axes (Ramanujan 1914, error < 1e-5 here) [m]."""
    return math.pi * (3.0 * (a + b) - math.sqrt((3.0 * a + b) * (a + 3.0 * b)))


def _range_on_line(n: int) -> float:
    if n == 1:
        return 0.0
    return min(1.1, 2.0 * HALF_LENGTH / (n - 1)) * (1.12 if n >= CROWD else 1.0)


def _repulsion(fleet: Fleet, s: float) -> float:
    """k_c [N/m]; 0 for a single vehicle."""
    if s == 0.0:
        return 0.0
    if s <= CLOSEST:
        raise MismatchError(f"room for {fleet.count} vehicles", f"{s:.2f} m for each")
    return 1.2 * fleet.force / (s - CLOSEST)


def _push(n: int, k_c: float, s: float) -> float:
    """Outward force on a vehicle by the repulsion of the others on the circle [N]."""
    force = 0.0
    for j in range(1, n):
        d = 2.0 * RADIUS * math.sin(math.pi * j / n)
        force += k_c * max(0.0, s - d) * math.sin(math.pi * j / n)
    return force


def reaches(field: Field) -> tuple[float, float]:
    """Half extent of a planar field's curve along x and y [m]; 0 where it is unbounded."""
    top = field.a * field.b * field.r + max(field.mu, 0.0)
    return top / field.b if field.b else 0.0, top / field.a if field.a else 0.0


def distance_to(shape: Shape, p: Array) -> Array:
    """Distance of points from the curve of `shape` on the table.

    Args:
        shape: the formation.
        p: points relative to the centre of the formation, shape (..., 2) [m].

    Returns:
        distances, shape (...) [m].
    """
    match shape:
        case "circle":
            return np.abs(np.hypot(p[..., 0], p[..., 1]) - RADIUS)
        case "line":
            return np.abs(p[..., 1])
        case "double_line":
            return np.abs(np.abs(p[..., 1]) - OFFSET)
        case "ellipse" | "flat":
            a, b, r = AXES[shape]
            angle = np.linspace(0.0, 2.0 * np.pi, 20_000)  # 0.5 mm apart
            x, y = a * r * np.cos(angle), b * r * np.sin(angle)
            gaps = np.hypot(p[..., :1] - x, p[..., 1:] - y)
            return gaps.min(axis=-1)
