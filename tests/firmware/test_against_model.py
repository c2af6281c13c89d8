"""The firmware against `sim_twin.board.play`, written independently for the twin.

Both play plans by the same rules as long as no limit of the firmware's own comes into it.
"""

import numpy as np
import pytest

from sim_twin.board import LONG_AGO, Wires, no_pulses, play
from sim_twin.randomness import stream, words

FREE = {
    "opposing": (0,) * 8,
    "max_on_us": 10_000_000,
    "duty_window_us": 160_000_000,
    "duty_budget_us": 160_000_000,
    "watchdog_us": 2_000_000,
}


def plan(rng, limits):
    """On-times and offsets, many of them exactly at a limit."""
    special = [0, 0, 1, limits.min_on_us - 1, limits.min_on_us, limits.min_on_us + 1, 100_000]
    on = [int(rng.choice([rng.integers(0, 120_000), rng.choice(special)])) for _ in range(8)]
    offset = [int(rng.choice([0, 0, rng.integers(0, 60_000)])) for _ in range(8)]
    ttl = int(rng.choice([150_000, rng.integers(20_000, 150_000)]))
    return on, offset, ttl


def steps(pulses):
    """Edges per valve from the model's pulses, which forgets all but the newest."""
    return [
        [(int(u) // 1000, int(d) // 1000) for u, d in zip(up, down, strict=True) if u > LONG_AGO]
        for up, down in zip(pulses.up, pulses.down, strict=True)
    ]


def openings(edges):
    """Pulses (up, down) per valve from mask edges."""
    found = [[] for _ in range(8)]
    mask = 0
    for edge in edges:
        for valve in range(8):
            if (edge.mask ^ mask) >> valve & 1:
                if edge.mask >> valve & 1:
                    found[valve].append([edge.t_us, None])
                else:
                    found[valve][-1][1] = edge.t_us
        mask = edge.mask
    return [[tuple(pulse) for pulse in valve] for valve in found]


@pytest.mark.parametrize("seed", range(20))
def test_same_edges_on_random_plans(new_host, seed):
    rng = np.random.default_rng(seed)
    host = new_host(board={"clock_us": int(rng.integers(0, 1 << 32))}, **FREE)
    pulses, seen = no_pulses(8), [{} for _ in range(8)]
    shortest = host.limits.min_on_us * 1000, host.limits.min_off_us * 1000
    wires = Wires(pulses, np.array((0, *shortest)), 0.0, words(stream(seed, "pulses")))
    for number in range(100):
        on, offset, ttl = plan(rng, host.limits)
        start = host.board.now_us
        host.plan(number, dict(enumerate(on)), dict(enumerate(offset)), ttl)
        play(wires, 1e-6 * start, 1e-6 * (start + ttl), np.array([*on, *offset]))
        wait = int(rng.choice([100_000, ttl, rng.integers(1, 150_000), max(on), min(offset)]))
        host.wait(max(1, wait))
        for valve, found in enumerate(steps(pulses)):
            now = host.board.now_us
            for stale in [up for up in seen[valve] if up >= start]:
                del seen[valve][stale]
            seen[valve].update({up: down for up, down in found if up < now})
    host.wait(400_000)
    for valve, found in enumerate(steps(pulses)):
        seen[valve].update(dict(found))
    expected = [sorted((up, down) for up, down in valve.items() if down > up) for valve in seen]
    assert openings(host.edges) == expected
    assert sum(map(len, expected)) > 100
