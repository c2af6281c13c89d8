r"""Bifurcating potential field: a few parameters select and change the shape of a cluster.

Source: W. Gao, K. Li, C. Wei, "Satellite cluster formation reconfiguration based on the bifurcating
potential field", Aerospace 9:137, 2022. Equation numbers are that paper's.

    paper      code              meaning                                             unit
    x_i        x                 position relative to the formation's centre         m
    v_i        own.v - goal.v    velocity relative to it                             m/s
    x_ij       p - others        position relative to another satellite              m
    a, b, c    weight, level     shape; c is for surfaces in space                   -
    r          level             size                                                m
    mu         mu                bifurcation parameter: < 0 one curve, > 0 two       m
    sigma      lift              holds planar formations in their plane              m
    k_f        k_f               formation                                           N/m^2
    k_v        k_v               damping                                             kg/s
    k_c, s     k_c, s            repulsion and the distance at which it ends         N/m, m

With q = sqrt(b^2 x^2 + a^2 z^2) and rho = q - a b r, or for surfaces in space
q = sqrt(b^2 c^2 x^2 + a^2 c^2 y^2 + a^2 b^2 z^2) and rho = q - a b c r, the cluster gathers where
rho = 0 (mu < 0) or rho = +-mu (mu > 0): on circles, ellipses, lines (b = 0), ellipsoids. The plane
of a planar formation is x, z in space and x, y on the table. Where q = 0 the direction is undefined
and the formation force zero.

Corrections to the print; without them the paper's figures cannot be reproduced. Eq. (13): the sign
is reversed for x_ij as defined; as printed the satellites attract each other and the cluster
collapses. Eq. (12): (k_c/2)(s - d)^2 is the potential of that force; the printed one has another
factor, attracts below s/2 and jumps at s. Eq. (10): v_i is the velocity relative to the centre, not
the inertial one. Tables 1 and 2: the double ellipse has semi-axes ar +- mu/b and br +- mu/a, the
double ellipsoid ar +- mu/(bc) and so on: Eqs. (22), (24) have their minima there.

The paper's numbers are in km, kg, s; it does not state the unit of force.
`scale = { length = 0.001 }` reads forces as kN, the coherent unit. `scale = { length = 0.001,
mass = 1e5 }`, for its satellites of 100 kg, reads them as N and reproduces more of the transients
that it describes.

Differences from the paper: `phases` switch the field at their times. The formation force is
limited to `cap` and the total force to own.max_force, direction kept. `wall` pushes back vehicles
that leave the table: nothing holds a vehicle along a line and the repulsion stretches it. The law
cancels all of own.disturbance, not only the orbital dynamics, and follows the centre's
acceleration. A phase may name a shape; `controllers.bifurcating_design` then fills in the numbers
not given.
"""

from itertools import pairwise
from typing import ClassVar, NamedTuple

import msgspec
import numpy as np
from msgspec import Struct
from msgspec import field as struct_field
from numpy.typing import NDArray

from controllers.bifurcating_design import Field, Fleet, Shape, design
from controllers.graph import FormationKind
from controllers.scale import Scale
from testbed.core.compiled import compiled
from testbed.core.error import MismatchError
from testbed.core.law import CompiledLaw, Law, bounded, no_state
from testbed.core.law_verbs import compiled_rate
from testbed.core.vehicle import NonNegative, Positive

Array = NDArray[np.float64]


class Phase(Struct, frozen=True, forbid_unknown_fields=True):
    """A formation and its start time; without a shape a, b, mu, k_f, k_v must be given."""

    at: NonNegative = 0.0  # since the start of the run [s]
    shape: Shape | None = None  # the design fills in the numbers not given here
    a: NonNegative | None = None
    b: NonNegative | None = None
    c: Positive | None = None
    r: NonNegative | None = None  # [m]
    mu: float | None = None  # [m]
    sigma: NonNegative | None = None  # [m]
    k_f: Positive | None = None  # [N/m^2]
    k_v: NonNegative | None = None  # [kg/s]
    k_c: NonNegative | None = None  # [N/m]
    s: NonNegative | None = None  # [m]
    cap: Positive | None = None  # on the formation force [N]

    def __post_init__(self) -> None:
        if self.shape is None:
            missing = [
                name for name in ("a", "b", "mu", "k_f", "k_v") if getattr(self, name) is None
            ]
            if missing:
                raise MismatchError(f"a shape or {', '.join(missing)}", "neither")

    def given(self) -> dict[str, float]:
        """Numbers of the field that the phase sets explicitly."""
        names = Field.__struct_fields__
        return {name: value for name in names if (value := getattr(self, name)) is not None}


class Wall(Struct, frozen=True, forbid_unknown_fields=True):
    """A spring on every axis that acts beyond a distance from the frame's origin."""

    at: Positive  # [m]
    stiffness: Positive  # [N/m]


class BifurcatingParams(Struct, frozen=True, forbid_unknown_fields=True, tag="bifurcating"):
    """The sequence of formations and their centre."""

    forms: ClassVar[FormationKind] = "curves"
    phases: tuple[Phase, ...]
    fleet: Fleet | None = None  # vehicles the shapes are designed for
    centre: tuple[float, ...] | None = None  # of the formation [m]; null: the vehicle's own goal
    wall: Wall | None = None
    scale: Scale = struct_field(default_factory=Scale)

    def __post_init__(self) -> None:
        if not self.phases:
            raise MismatchError("at least one phase", "none")
        if self.phases[0].at != 0.0:
            raise MismatchError("a first phase at 0 s", f"{self.phases[0].at:g} s")
        for one, two in pairwise(self.phases):
            if two.at <= one.at:
                raise MismatchError("phases in order of time", f"{two.at:g} s after {one.at:g} s")
        if self.fleet is None and any(phase.shape for phase in self.phases):
            raise MismatchError("`fleet`, the vehicles to design the shapes for", "none")

    def field(self, phase: Phase) -> Field:
        """The field of a phase, designed where the phase gives no numbers."""
        if phase.shape is None or self.fleet is None:
            return Field(**phase.given())
        return msgspec.structs.replace(design(self.fleet, phase.shape), **phase.given())


class Gains(NamedTuple):
    """Parameters for compiled code, one row per phase."""

    at: Array  # (n,)
    weight: Array  # (n, d) of Eq. (22) or (25), squared: q^2 = sum weight x^2
    level: Array  # (n,) a b r or a b c r
    mu: Array  # (n,)
    lift: Array  # (n, d) sigma across the plane, 0 in it
    k_f: Array  # (n,)
    k_v: Array  # (n,)
    k_c: Array  # (n,)
    s: Array  # (n,)
    cap: Array  # (n,)
    fixed: bool  # use `centre` instead of the goal
    centre: Array  # (d,)
    wall_at: float
    wall_stiffness: float


@compiled
def formation_force(gains, k, x):
    """Eqs. (23), (26): the negative gradient of phase `k`'s potential at `x`, cut at the cap."""
    force = np.empty(x.shape[0])
    write_formation_force(gains, k, x, force)
    return force


@compiled
def write_formation_force(gains, k, x, force):
    """Write `formation_force` to `force`, without allocating."""
    d = x.shape[0]
    square = 0.0
    for i in range(d):
        square += gains.weight[k, i] * x[i] * x[i]
    q = np.sqrt(square)  # Eq. (25)
    rho = q - gains.level[k]
    steep = gains.k_f[k] * (rho * abs(rho) - gains.mu[k] * rho) / q if q > 0.0 else 0.0
    size = 0.0
    for i in range(d):
        across = 2.0 * gains.k_f[k] * gains.lift[k, i]
        force[i] = -(steep * gains.weight[k, i] + across) * x[i]
        size += force[i] * force[i]
    if size > gains.cap[k] * gains.cap[k]:
        for i in range(d):
            force[i] *= gains.cap[k] / np.sqrt(size)


@compiled
def add_repulsion(k_c, s, p, others, force):
    """Eqs. (13), (14), corrected, added to `force` in place."""
    for j in range(others.shape[0]):
        square = 0.0
        for i in range(p.shape[0]):
            square += (p[i] - others[j, i]) ** 2
        if 0.0 < square < s * s:
            strength = k_c * (s / np.sqrt(square) - 1.0)
            for i in range(p.shape[0]):
                force[i] += strength * (p[i] - others[j, i])


@compiled_rate(Gains)
def rate(gains, law_state, own, neighbours, world, t):
    """Force, see `testbed.core.law`; the law has no state."""
    d = own.p.shape[0]
    k = 0
    while k + 1 < gains.at.shape[0] and gains.at[k + 1] <= t:
        k += 1
    centre = gains.centre if gains.fixed else world.goal.p
    force = formation_force(gains, k, own.p - centre)
    add_repulsion(gains.k_c[k], gains.s[k], own.p, neighbours.p, force)
    for i in range(d):
        speed, lead = own.v[i], 0.0
        if not gains.fixed:
            speed, lead = own.v[i] - world.goal.v[i], world.goal.a[i]
        beyond = max(0.0, abs(own.p[i]) - gains.wall_at)
        force[i] += (  # Eq. (10)
            -gains.k_v[k] * speed
            - gains.wall_stiffness * beyond * np.sign(own.p[i])
            + own.mass * (lead - own.disturbance[i])
        )
    return bounded(force, own.max_force), np.empty(0)


def _geometry(field: Field, d: int) -> tuple[Array, float, Array]:
    """Squared weights of q (d,), value of q on the curve, stiffness across the plane (d,)."""
    a, b, c = field.a, field.b, field.c
    if d not in (2, 3):
        raise MismatchError("2 or 3 dimensions", f"{d}")
    if c is None:
        plane = (b * b, a * a) if d == 2 else (b * b, 0.0, a * a)
        lift = (0.0, 0.0) if d == 2 else (0.0, field.sigma, 0.0)
        return np.array(plane), a * b * field.r, np.array(lift)
    if d == 2:
        raise MismatchError("no c on a table (c defines a surface in space)", "one")
    weight = np.array([b * b * c * c, a * a * c * c, a * a * b * b])
    return weight, a * b * c * field.r, np.zeros(3)


def bifurcating(params: BifurcatingParams, d: int) -> Law:
    """The law for positions of shape (d,)."""
    fields = [params.field(phase) for phase in params.phases]
    weight, level, lift = zip(*(_geometry(field, d) for field in fields), strict=True)
    centre = np.zeros(d) if params.centre is None else np.array(params.centre, dtype=float)
    if centre.shape != (d,):
        raise MismatchError(f"a centre of {d} coordinates", f"{len(centre)}")

    def row(name: str) -> Array:
        return np.array([getattr(field, name) for field in fields], dtype=float)

    gains = Gains(
        at=np.array([phase.at for phase in params.phases]),
        weight=np.array(weight),
        level=np.array(level),
        mu=row("mu"),
        lift=np.array(lift),
        k_f=row("k_f"),
        k_v=row("k_v"),
        k_c=row("k_c"),
        s=row("s"),
        cap=np.array([field.cap or np.inf for field in fields]),
        fixed=params.centre is not None,
        centre=centre,
        wall_at=params.wall.at if params.wall else np.inf,
        wall_stiffness=params.wall.stiffness if params.wall else 0.0,
    )
    return CompiledLaw(gains, no_state, rate)
