r"""The jets' effect matrix B.

The default vehicle, seen from above; arrows show the direction in which an open valve pushes the
*body*; the plume leaves in the opposite direction. Numbers are the jets' order in the vehicle file.

                 y_B
                  ^
           [7]    |    [8]
            v     |     v
         +--------+--------+
    [6]> |        |        | <[1]
         |        o--------+----> x_B
    [5]> |                 | <[2]
         +-----------------+
            ^           ^
           [4]         [3]

Any other layout works: the functions below use the positions and directions in the file.
"""

from collections.abc import Sequence

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from testbed.core.vehicle import Jet

Array = NDArray[np.float64]


class JetHealth(Struct, frozen=True):
    """One jet as a flight has shown it."""

    share: float  # of its thrust in the vehicle file, estimated while it was commanded
    sigma: float  # of that; 0.3: hardly ever commanded
    gives: float = 1.0  # share with which the vehicle flew: 0 is taken out
    leaks: float = 0.0  # share without a command with which it flew; 1: stuck open
    named_s: float | None = None  # time at which the last two changed; null: never [s]

    @property
    def words(self) -> str:
        """How the vehicle flew with it, for a person; empty: as with a healthy jet."""
        if self.named_s is None:
            return ""
        what = "taken out" if self.gives == self.leaks == 0.0 else f"flown at {self.gives:.0%}"
        if self.leaks:
            what = f"pushes at {self.leaks:.0%} without a command, compensated"
        return f"{what} since {self.named_s:.1f} s"


def effect_matrix(jets: Sequence[Jet], about: tuple[float, float] = (0.0, 0.0)) -> Array:
    """Wrench of each fully open jet: columns (fx, fy, tau), shape (3, n) [N, N, N m].

    Args:
        jets: the vehicle's jets.
        about: point of B about which the torque is taken [m].
    """
    columns = []
    for jet in jets:
        fx, fy = jet.thrust * jet.push[0], jet.thrust * jet.push[1]
        arm_x, arm_y = jet.position[0] - about[0], jet.position[1] - about[1]
        columns.append((fx, fy, arm_x * fy - arm_y * fx))
    return np.array(columns).T.reshape(3, len(columns))


def opposing_pairs(jets: Sequence[Jet]) -> list[tuple[int, int]]:
    """Pairs of jets that push against each other along one line: open together, they waste gas."""
    pairs = []
    for i, a in enumerate(jets):
        for j in range(i + 1, len(jets)):
            b = jets[j]
            against = a.push[0] * b.push[0] + a.push[1] * b.push[1]
            gap = (b.position[0] - a.position[0], b.position[1] - a.position[1])
            off_line = gap[0] * a.push[1] - gap[1] * a.push[0]
            if against < -0.99 and abs(off_line) < 0.01:
                pairs.append((i, j))
    return pairs
