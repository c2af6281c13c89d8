"""The formations of xue2021, xue2022 and xue2024 on the twin: no touch, no edge lost, as wanted."""

import numpy as np
import pytest

from controllers.graph import formation
from testbed.config import find, load
from testbed.core.types import HostTick, Tick
from testbed.metrics.run_metrics import obstacle_distances
from testbed.rig.twin import make_twin

SAFE = 0.4  # two radii [m]


class NullObserver:
    """Observer of a flight."""

    def vehicle(self, name: str, tick: Tick) -> None: ...

    def host(self, name: str, tick: HostTick) -> None: ...

    def done(self, t: float) -> None: ...


def flown(name, *overrides, drift=0.0):
    """Experiment, track, and pair -> (distances, desired, whether of E(0))."""
    experiment = load(find(name), overrides)
    rig = make_twin(experiment)
    rig.twin.plant.x[:, 3] = drift  # velocity along x at the start [m/s]
    ending = rig.fly(NullObserver())
    assert ending.fault is None
    assert not rig.twin.plant.touches
    led = "leader" in type(experiment.controller).__struct_config__.tag
    shape = formation(experiment.controller.formation, list(experiment.vehicles), led)
    track = rig.track()
    p, pairs = track.states[:, :, :2], {}
    for i in range(p.shape[1]):
        for j in range(i):
            gap = np.linalg.norm(p[:, i] - p[:, j], axis=1)
            pairs[i, j] = gap, shape.desired[i, j], shape.first[i, j] > 0.0
            assert gap.min() > SAFE
            assert not pairs[i, j][2] or gap.max() < shape.range
    for k in range(p.shape[1]):
        for rock, nearest in obstacle_distances(track, k, experiment.obstacles).items():
            assert nearest > experiment.obstacles[rock].radius
    return experiment, track, pairs


@pytest.mark.parametrize("seed", [0, 1])
@pytest.mark.parametrize("overrides", [(), ("deploy.law=host",)], ids=["vehicle", "host"])
@pytest.mark.parametrize(
    ("name", "speed", "settles_s"),
    # 27.8 s and 44.6 s in the design study of these gains, with on-off jets; 20 % more at most
    [("xue2022_table", 0.0, 33.4), ("xue2024_table_constant", 0.01, 53.5)],
)
def test_a_chain_settles_at_its_edges_and_moves_with_its_leader(
    name: str, speed: float, settles_s: float, overrides: tuple[str, ...], seed: int
) -> None:
    _, track, pairs = flown(name, *overrides, f"seed={seed}")
    edges = [gap - wanted for gap, wanted, first in pairs.values() if first]
    for off in edges:
        assert abs(off[track.t > settles_s]).max() < 0.05
        assert abs(off[-1]) < 0.02
    assert track.states[-1, :, 3:5] == pytest.approx(np.tile([0.0, speed], (3, 1)), abs=0.004)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "settles_s", "tolerance"),
    # in the design study, 20 % more at most: 47.8 s to 3 cm, ideal; 101 s to 5 cm; 70 s and 97.6 s
    # for all three pairs to 8 cm and 5 cm
    [
        ("xue2022_table_obstacle", 57.4, 0.03),
        ("xue2024_table_varying", 121.0, 0.05),
        ("xue2021_table_static", 84.0, 0.08),
        ("xue2021_table_dynamic", 117.0, 0.05),
    ],
)
def test_a_formation_among_obstacles_or_behind_a_leader(name, settles_s, tolerance):
    experiment, track, pairs = flown(name, "seed=3")
    far = experiment.controller.formation.far
    for gap, wanted, _ in pairs.values():
        if wanted < far:
            assert abs(gap - wanted)[track.t > settles_s].max() < tolerance


@pytest.mark.slow
def test_from_the_papers_start_the_static_formation_settles_as_designed():
    """All drift towards the obstacle, as in xue2021's Table 2 over 48: 36.5 s to 5 cm, ideal."""
    _, track, pairs = flown(
        "xue2021_table_static", "obstacles.o1.position=[1.25,0.0]", "arming.at_rest=0.2",
        "seed=3", drift=0.1,
    )  # fmt: skip
    for gap, wanted, first in pairs.values():
        if first:
            assert abs(gap - wanted)[track.t > 1.2 * 36.5].max() < 0.05
