"""Injected faults of a lab: hoses, pads and regulators, and cameras that move or are late."""

import math
from collections import deque

from sim_twin.plant import PADS, Plant
from testbed.core.fault_injection import Injection
from testbed.core.se2 import wrap
from testbed.core.types import PoseSample

OF_BODIES = ("hose", "pad_drag", "regulator", "thrust", "mass")  # begin with the next tick
OF_FRAMES = ("shift_frame", "turn_frame", "creep_frame")  # of all bodies that the cameras see
LONGEST_DELAY = 3.0  # of poses that `Late` keeps [s]


class BodyFaults:
    """Switches faults of bodies on and off in the plant's parameters."""

    def __init__(self, plant: Plant) -> None:
        self._plant = plant
        self._on: set[tuple[int, str]] = set()

    def apply(self, k: int, what: Injection, *, holds: bool) -> None:
        """Let a fault of vehicle `k` begin or end."""
        key = k, what.kind
        if holds == (key in self._on):
            return
        (self._on.add if holds else self._on.discard)(key)
        p, sign = self._plant.parameters, 1.0 if holds else -1.0
        match what.kind:
            case "hose":
                way, pull = math.radians(what.towards_deg), sign * what.size
                p.hose[k, 0] += pull * math.cos(way)
                p.hose[k, 1] += pull * math.sin(way)
            case "pad_drag":
                p.drag[k] += sign * what.size
                p.spin_drag[k] += sign * what.size * (PADS * p.radius[k]) ** 2
            case "mass":
                p.mass[k] *= what.size**sign
            case _:
                p.effect[k] *= what.size**sign
                p.thrust[k] *= what.size**sign


class Late:
    """A body's poses that come late, with stamps as if they did not."""

    def __init__(self) -> None:
        self._seen: deque[PoseSample] = deque()
        self._last: PoseSample | None = None

    def pose(self, now: PoseSample, delay: float) -> PoseSample | None:
        """The pose that was true `delay` before, with this one's stamp; None: it was lost."""
        self._seen.append(now)
        while now.captured_at - self._seen[0].captured_at > LONGEST_DELAY:
            self._seen.popleft()
        if delay == 0.0:
            return now
        due = now.captured_at - delay
        old = [one for one in self._seen if one.captured_at <= due]
        then = old[-1] if old else now  # before the flight it was at rest
        if then is self._last:
            return None
        self._last = then
        return PoseSample(now.captured_at, then.x, then.y, then.theta)


def moved(sample: PoseSample, dx: float, dy: float) -> PoseSample:
    """A pose elsewhere [m]."""
    return PoseSample(sample.captured_at, sample.x + dx, sample.y + dy, sample.theta)


def turned(sample: PoseSample, turn: float) -> PoseSample:
    """A pose with another heading [rad]."""
    return PoseSample(sample.captured_at, sample.x, sample.y, wrap(sample.theta + turn))
