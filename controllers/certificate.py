r"""Checks, before a flight, that its start satisfies the conditions of the bounded laws' proofs.

Sources: X. Xue, X. Yue, J. Yuan, "Connectivity preservation and collision avoidance control for
spacecraft formation flying with bounded actuation", ICGNC 2020, Springer 2022, Lemma 4; X. Xue,
X. Wang, N. Han, "Leader-following connectivity preservation and collision avoidance control for
multiple spacecraft with bounded actuation", Aerospace 11:612, 2024, Lemma 6, Theorem 2, Eqs. (10),
(15)-(17). Equation numbers are those of 2024.

    V   = V_k + sum of P psi over the edges + sum of phi_i
    V_k = sum (m_i |s_i|^2 + mass |p_i hat' - p_0'|^2) / 2

As V does not grow, V(0) <= phi_min keeps every satellite within epsilon/2 of its proxy, and
V(0) < P Q keeps every edge between its ends. Together: no initial edge is lost, and satellites that
share an edge do not collide.

Corrections to the print: Lemma 6 omits V_k(0), but followers that start at rest have the velocity
-p_0' relative to the leader. P = phi_min/Q, Eq. (19), is not needed; the two conditions are.

A law often works well although a condition is violated, so violations are `Concern`s with
identifiers and not errors.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from controllers.bounded_potential import BoundedPotential, bounded_potential
from controllers.graph import pinned, smallest_eigenvalue
from controllers.proxy import Coupling
from testbed.core.law import Concern, Discs

Array = NDArray[np.float64]


class ProxyFleet(NamedTuple):
    """Satellites with their proxies, and the leader; rows in the order of `Body.vehicle_index`."""

    mass: Array  # (n,) [kg]
    p: Array  # (n, d) [m]
    v: Array  # (n, d) [m/s]
    proxy_p: Array  # (n, d) [m]
    proxy_v: Array  # (n, d) [m/s]
    leader_p: Array  # (d,) arbitrary without a leader [m]
    leader_v: Array  # (d,) zero without a leader [m/s]


def starting(mass: Array, p: Array, v: Array, leader_p: Array, leader_v: Array) -> ProxyFleet:
    """A fleet at the start: each proxy is at rest at its satellite's position."""
    return ProxyFleet(mass, p, v, p, np.zeros_like(v), leader_p, leader_v)


def spring_energy(c: Coupling, stretch: Array) -> Array:
    """phi, Eq. (9), the sum over the last axis of `stretch` [J]."""
    corner = c.limit / c.spring
    size = np.abs(stretch)
    inner = 0.5 * c.spring * stretch**2
    return np.where(size <= corner, inner, c.limit * (size - 0.5 * corner)).sum(axis=-1)


def least_spring_energy(c: Coupling) -> float:
    """phi_min, Eq. (10): least energy at the distance epsilon/2, which is on an axis [J]."""
    margin = min(c.margin, c.formation.range - c.formation.far)
    return float(spring_energy(c, np.array([0.5 * margin])))


def _edges_energy(c: Coupling, fleet: ProxyFleet, edge: Array) -> float:
    points = np.vstack((fleet.proxy_p, fleet.leader_p))
    total = 0.0
    for i, j in np.argwhere(np.triu(edge) > 0.0):
        x = float(np.linalg.norm(points[i] - points[j]))
        total += bounded_potential(c.potential, x, c.formation.desired[i, j])[0]
    return c.weight * total


def _obstacles_energy(c: Coupling, fleet: ProxyFleet, obstacles: Discs) -> float:
    total = 0.0
    for centre, radius in zip(obstacles.p, obstacles.radius, strict=True):
        wall = BoundedPotential(radius + c.margin, c.potential.far, c.potential.height)
        for x in np.linalg.norm(fleet.proxy_p - centre, axis=1):
            if x < radius + c.band:
                total += bounded_potential(wall, float(x), float(radius + c.band))[0]
    return c.weight * total


def energy(c: Coupling, fleet: ProxyFleet, edge: Array, obstacles: Discs | None = None) -> float:
    """V, Eqs. (15)-(17), with the edges (n + 1, n + 1) given, leader last [J]."""
    s, bar = fleet.v - fleet.leader_v, fleet.proxy_v - fleet.leader_v
    kinetic = 0.5 * float(fleet.mass @ (s**2).sum(axis=1) + c.mass * (bar**2).sum())  # Eq. (16)
    springs = float(spring_energy(c, fleet.p - fleet.proxy_p).sum())
    total = kinetic + springs + _edges_energy(c, fleet, edge)
    if obstacles is not None and c.band > 0.0:
        total += _obstacles_energy(c, fleet, obstacles)
    return total


def _edge_concerns(c: Coupling, fleet: ProxyFleet, names: Sequence[str]) -> list[Concern]:
    shape, found = c.formation, []
    points = np.vstack((fleet.p, fleet.leader_p))
    called = [*(names or map(str, range(len(fleet.p)))), "the leader"]
    for i, j in np.argwhere(np.triu(shape.first) > 0.0).tolist():
        x = float(np.linalg.norm(points[i] - points[j]))
        if not shape.near < x < shape.far:
            who = f"{called[i]} and {called[j]}"
            found.append(
                Concern(
                    "edge-outside-potential",
                    f"the edge between {who} starts {x:.4g} m long; the potential covers "
                    f"{shape.near:.4g} to {shape.far:.4g} m",
                )
            )
    return found


def certificate(
    c: Coupling,
    fleet: ProxyFleet,
    max_force: float,
    obstacles: Discs | None = None,
    names: Sequence[str] = (),
) -> list[Concern]:
    """Conditions of Lemma 6 that this start violates; empty: the guarantee holds.

    Args:
        c: coupling of the law, with E(0).
        fleet: at the start.
        max_force: norm of the force of the weakest satellite [N].
        obstacles: that the proxies avoid, if any.
        names: of the satellites, for the messages.
    """
    found = _edge_concerns(c, fleet, names)
    v0, least = energy(c, fleet, c.formation.first, obstacles), least_spring_energy(c)
    if v0 > least:
        found.append(
            Concern(
                "start-energy",
                f"V(0) = {v0:.4g} J is more than phi_min = {least:.4g} J: a satellite may move "
                "more than epsilon/2 from its proxy; start slower or nearer to the desired "
                "distances, lower the weight, or widen the margins",
            )
        )
    height = c.weight * c.potential.height
    if v0 >= height:
        found.append(
            Concern(
                "barrier-height",
                f"V(0) = {v0:.4g} J is not less than P Q = {height:.4g} J: an edge may be lost or "
                "collide; raise the height",
            )
        )
    axis = max_force / np.sqrt(fleet.p.shape[1])
    if c.limit > axis:
        found.append(
            Concern(
                "limit-beyond-thrust",
                f"the spring's limit {c.limit:.4g} N exceeds what a satellite can push along all "
                f"axes at once, {axis:.4g} N: the force is cut, which the proof does not cover",
            )
        )
    return found


def sgn_certificate(
    c: Coupling, alpha: float, beta: float, layer: float, mass: Array, leader_accel: float
) -> list[Concern]:
    """Conditions of Theorem 2 that these gains violate, and its claims that do not hold.

    Args:
        c: coupling of the law, with E(0).
        alpha: gain of sgn between proxies [N].
        beta: gain of sgn between satellites [N].
        layer: boundary layer of sgn [m/s].
        mass: (n,) [kg].
        leader_accel: largest |p_0''| [m/s^2].
    """
    least = smallest_eigenvalue(pinned(c.formation.first))
    needed = np.sqrt(len(mass)) * leader_accel / np.sqrt(least)  # gamma/sqrt(lambda_min)
    found = [
        Concern(
            f"{name}-too-small",
            f"{name} = {value:.4g} N is not more than {weight * needed:.4g} N, required for the "
            f"leader's acceleration of {leader_accel:.4g} m/s^2: velocities may not converge",
        )
        for name, value, weight in (("alpha", alpha, c.mass), ("beta", beta, float(max(mass))))
        if value <= weight * needed
    ]
    if layer > 0.0:
        found.append(
            Concern(
                "boundary-layer",
                f"the proof is for sgn; inside a boundary layer of {layer:.4g} m/s V may grow",
            )
        )
    else:
        found.append(
            Concern(
                "lock-in",
                "true sgn acts as dry friction: the formation stops where the potential's forces "
                "are smaller than it, and Theorem 2 (3) does not hold",
            )
        )
    return found
