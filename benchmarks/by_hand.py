"""How a vehicle on the twin comes to rest when its operator falls silent, or lets go of the stick.

    python benchmarks/by_hand.py

`hold`, flown at the top speed along x from 2 s on. At 8 s the messages end, or the stick goes to
the middle. Prints the time and the distance from then until the true speed is below 1 cm/s.
"""

from collections.abc import Callable, Iterator

import numpy as np
from msgspec.structs import replace

from testbed.config import find, load
from testbed.net.operator_requests import OperatorRequest, Reply, Steer
from testbed.rig.live import LiveFlight
from testbed.rig.observers import NullObserver
from testbed.rig.twin import make_twin, warm_up

FROM, UNTIL, STICK_HZ = 2.0, 8.0, 10.0
STILL = 0.01  # [m/s]


class Operator:
    """A page whose stick is held at the right, heard at every tick."""

    def __init__(self, *, lets_go: bool) -> None:
        self.t, self._lets_go = 0.0, lets_go

    def now_ns(self) -> int:
        """Time of the run."""
        return round(1e9 * self.t)

    def received(self) -> Iterator[tuple[OperatorRequest, Callable[[Reply], None]]]:
        """See `RequestSource`."""
        held = self.t < UNTIL
        if self.t >= FROM and (held or self._lets_go):
            x = 1.0 if held else 0.0
            yield Steer("sat1", "velocity", "me", self.now_ns(), x), lambda reply: None


class Clock(NullObserver):
    """Tells the operator the time."""

    def __init__(self, operator: Operator) -> None:
        self._operator = operator

    def done(self, t: float) -> None:
        """See `Observer`."""
        self._operator.t = t + 1.0 / STICK_HZ


def main() -> None:
    """Fly both, and print."""
    experiment = load(find("hold"), ["duration_s=16", "criteria={}", "obstacles={}"])
    warm_up(experiment)
    for lets_go, words in ((False, "falls silent"), (True, "lets go")):
        operator = Operator(lets_go=lets_go)
        live = LiveFlight(experiment, operator, lambda one: None, operator.now_ns)
        rig = replace(make_twin(experiment), live=live)
        rig.fly(Clock(operator))
        track = rig.track()
        t, state = track.t, track.states[:, 0]
        speed = np.hypot(state[:, 3], state[:, 4])
        end = t[np.flatnonzero((t > UNTIL) & (speed > STILL))[-1]]
        x = np.interp([UNTIL, end], t, state[:, 0])
        print(
            f"{words}: at {speed[t < UNTIL][-1]:.3f} m/s; rests after {end - UNTIL:.2f} s"
            f" and {x[1] - x[0]:.3f} m"
        )


if __name__ == "__main__":
    main()
