"""Figures of xue2021, xue2022, xue2024: paths with obstacles, distances, velocities, forces."""

from collections.abc import Sequence
from itertools import combinations

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from testbed.reproduction.figure import Figure, Reading, thinned
from testbed.reproduction.kernel.fleet import FleetFlight, Place, wave_integral

Array = NDArray[np.float64]


class Tracks(Struct, frozen=True):
    """A flight with the leader as the last satellite."""

    t: Array
    p: Array  # (m, n + 1, 3)
    v: Array
    edge: Array  # (m, n + 1, n + 1)


def figures(
    names: Sequence[str], where: Place, track: Tracks, f: FleetFlight, *, led: bool, bounded: bool
) -> list[Figure]:
    """Figures of a flight; `led`: with a leader, `bounded`: with proxies."""
    members = [*names, "leader"] if led else list(names)
    t, p = thinned(track.t), thinned(track.p)
    gaps = {
        f"{members[i]}-{members[j]}": (t, np.linalg.norm(p[:, i] - p[:, j], axis=1))
        for i, j in combinations(range(len(members)), 2)
    }
    clipped = np.clip(f.wanted, -where.max_axis, where.max_axis)
    found = [
        *_around(members, where, track),
        Figure("distances between the spacecraft", "time [s]", "distance [m]", gaps,
               readings=(Reading(("final *", "longest *", "shortest *", "edges_longest_m",
                                  "closest_m")), Reading(("edges_settle_s",), "x"),
                         Reading(("edges_off_m", "lost_edges"), ""))),
        Figure("velocities", "time [s]", "velocity [m/s]", _axes(names, t, thinned(f.v)),
               readings=(Reading(("speed_end", "speed_axis_end")),)),
        Figure("control forces", "time [s]", "force [N]", _axes(names, t, thinned(clipped)),
               readings=(Reading(("raw_n",)),)),
    ]  # fmt: skip
    if bounded:
        slack = {
            name: (t, thinned(np.linalg.norm(f.p[:, k] - f.z[:, k, :3], axis=1)))
            for k, name in enumerate(names)
        }
        found.append(Figure("distances to the proxies", "time [s]", "distance [m]", slack,
                            readings=(Reading(("proxy_m", "proxy_end_m")),
                                      Reading(("proxy_speed_end",), ""))))  # fmt: skip
    return found


def _axes(names: Sequence[str], t: Array, values: Array) -> dict[str, tuple[Array, Array]]:
    return {
        f"{name} {axis}": (t, values[:, k, d])
        for k, name in enumerate(names)
        for d, axis in enumerate("xyz")
    }


def _around(members: Sequence[str], where: Place, track: Tracks) -> list[Figure]:
    """The paths seen along z with the obstacles, and the distance to the nearest of them."""
    t, p = thinned(track.t), thinned(track.p)
    paths = {name: (p[:, k, 0], p[:, k, 1]) for k, name in enumerate(members)}
    if len(where.obstacles) == 0:
        return [Figure("trajectory", "x [m]", "y [m]", paths, dots=True)]
    centres = np.array([where.obstacles + wave_integral(where.obstacles_v, one) for one in t])
    circles = [(*centre[:2].tolist(), float(r))
               for centre, r in zip(centres[-1], where.radius, strict=True)]  # fmt: skip
    moves = np.ptp(centres, axis=0).max() > 0.0
    ways = [(centres[:, k, 0], centres[:, k, 1]) for k in range(centres.shape[1]) if moves]
    off = np.linalg.norm(p[:, :, None] - centres[:, None], axis=3).min(axis=2)
    gaps = {name: (t, off[:, k]) for k, name in enumerate(members) if name != "leader"}
    return [
        Figure("trajectory", "x [m]", "y [m]", paths, dots=True, circles=tuple(circles),
               ways=tuple(ways)),
        Figure("distance to the nearest obstacle", "time [s]", "distance [m]", gaps,
               readings=(Reading(("obstacle_m",)), Reading(("obstacle_felt_s",), "x"))),
    ]  # fmt: skip
