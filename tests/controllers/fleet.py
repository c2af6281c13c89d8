"""Some satellites under one law, in a vacuum, hearing each other without delay: RK4 and no more.

The product flies them in `testbed.reproduction.kernel.fleet`. This is another one on purpose, in
plain Python: what the laws promise is tested without the code that the audit trusts, which
tests/reproduction/test_kernels.py compares with a third.
"""

import numpy as np

from testbed.core.law import Body, Discs, Goal, Neighbours, World


class Fleet:
    """`n` copies of a law; the law's module says how it tells and jumps, if it does."""

    def __init__(
        self, module, law, mass, disturbance=None, leader=None, obstacles=None, max_force=1e9
    ):
        self.module, self.law, self.mass = module, law, np.array(mass, dtype=float)
        self.disturbance = disturbance or (lambda p, v: np.zeros_like(p))
        self.leader = leader
        self.obstacles = obstacles or (lambda t: None)
        self.max_force = max_force

    def world(self, t, d):
        still = np.zeros(d)
        goal = Goal(*self.leader(t)) if self.leader else Goal(still, still, still, still)
        discs = self.obstacles(t) or Discs(np.zeros((0, d)), np.zeros((0, d)), np.zeros(0))
        return World(goal, discs)

    def bodies(self, p, v):
        still = np.zeros(p.shape[1])
        return [
            Body(p[i], v[i], self.mass[i], self.disturbance(p[i], v[i]), still, self.max_force, i)
            for i in range(len(p))
        ]

    def neighbours(self, i, t, p, v, told):
        others = np.delete(np.arange(len(p)), i)
        at = np.full(len(others), t)
        return Neighbours(p[others], v[others], np.ones(len(others)), others, told[others], at)

    def scene(self, t, p, v, z):
        """Own, neighbours and world of each satellite, everything told a moment ago."""
        world, bodies = self.world(t, p.shape[1]), self.bodies(p, v)
        silent = np.zeros((len(p), 0))
        told = silent
        if hasattr(self.module, "broadcast"):
            told = np.array(
                [
                    self.module.broadcast(
                        self.law.gains, z[i], own, self.neighbours(i, t, p, v, silent), world, t
                    )
                    for i, own in enumerate(bodies)
                ]
            )
        return [(own, self.neighbours(i, t, p, v, told), world) for i, own in enumerate(bodies)]

    def flow(self, t, p, v, z):
        """Derivatives of p, v, z, and the forces."""
        a, dz, forces = np.empty_like(v), np.empty_like(z), np.empty_like(v)
        for i, (own, neighbours, world) in enumerate(self.scene(t, p, v, z)):
            forces[i], dz[i] = self.law.rate(z[i], own, neighbours, world, t)
            a[i] = forces[i] / own.mass + own.disturbance
        return v, a, dz, forces

    def initial(self, p, v):
        return np.array([self.law.initial(own, None, None) for own in self.bodies(p, v)])

    def jumped(self, t, p, v, z):
        if not hasattr(self.module, "jump"):
            return z
        return np.array(
            [
                self.module.jump(self.law.gains, z[i], *sight, t)
                for i, sight in enumerate(self.scene(t, p, v, z))
            ]
        )

    def fly(self, p, v, duration, h, every=1):
        """Times, positions, velocities, law states and forces, one of `every` steps."""
        p, v = np.array(p, dtype=float), np.array(v, dtype=float)
        z, log = self.initial(p, v), []
        for k in range(round(duration / h) + 1):
            t = k * h
            z = self.jumped(t, p, v, z)
            v1, a1, z1, forces = self.flow(t, p, v, z)
            if k % every == 0:
                log.append((t, p, v, z, forces))
            v2, a2, z2, _ = self.flow(t + h / 2, p + h / 2 * v1, v + h / 2 * a1, z + h / 2 * z1)
            v3, a3, z3, _ = self.flow(t + h / 2, p + h / 2 * v2, v + h / 2 * a2, z + h / 2 * z2)
            v4, a4, z4, _ = self.flow(t + h, p + h * v3, v + h * a3, z + h * z3)
            p = p + h / 6 * (v1 + 2 * v2 + 2 * v3 + v4)
            v = v + h / 6 * (a1 + 2 * a2 + 2 * a3 + a4)
            z = z + h / 6 * (z1 + 2 * z2 + 2 * z3 + z4)
        return tuple(np.array(column) for column in zip(*log, strict=True))


def gaps(p, i, j):
    """Distance of two satellites over a flight, p of shape (steps, n, d)."""
    return np.linalg.norm(p[:, i] - p[:, j], axis=1)
