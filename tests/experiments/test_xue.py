"""The chains of xue2022 and xue2024 on the twin: no touch, no edge lost, edges as wanted."""

import numpy as np
import pytest

from testbed.config import find, load
from testbed.core.types import HostTick, Tick
from testbed.rig import make_twin

RANGE, SAFE, EDGE = 2.0, 0.5, 1.5  # [m]


class Nobody:
    """Observer of a flight."""

    def vehicle(self, name: str, tick: Tick) -> None: ...

    def host(self, name: str, tick: HostTick) -> None: ...

    def done(self, t: float) -> None: ...


@pytest.mark.parametrize("seed", [0, 1])
@pytest.mark.parametrize("overrides", [(), ("deploy.law=host",)], ids=["vehicle", "host"])
@pytest.mark.parametrize(
    ("name", "speed", "settles_s"),
    # 27.8 s and 44.6 s in the design study of these gains, with on-off jets; 20 % more at most
    [("xue2022_table", 0.0, 33.4), ("xue2024_table_constant", 0.01, 53.5)],
)
def test_a_chain(
    name: str, speed: float, settles_s: float, overrides: tuple[str, ...], seed: int
) -> None:
    experiment = load(find(name), [*overrides, f"seed={seed}"])
    rig = make_twin(experiment)
    ending = rig.fly(Nobody())
    assert ending.fault is None
    assert not rig.twin.plant.touches
    track = rig.track()
    p = track.states[:, :, :2]
    gap = {(i, j): np.linalg.norm(p[:, i] - p[:, j], axis=1) for i, j in ((0, 1), (1, 2), (0, 2))}
    edges = np.array([gap[0, 1], gap[1, 2]])
    assert edges.max() < RANGE
    assert min(one.min() for one in gap.values()) > SAFE
    assert abs(edges[:, track.t > settles_s] - EDGE).max() < 0.08
    assert abs(edges[:, -1] - EDGE).max() < 0.02
    assert track.states[-1, :, 3:5] == pytest.approx(np.tile([0.0, speed], (3, 1)), abs=0.004)
