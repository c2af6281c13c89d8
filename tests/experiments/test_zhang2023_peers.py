"""zhang2023's table experiment under the laws that one would otherwise pick."""

import numpy as np
import pytest

from testbed.config import find, load
from testbed.core.types import HostTick, Tick
from testbed.metrics.run_metrics import obstacle_distances, settle_time, smallest_separation
from testbed.rig.twin import make_twin


class NullObserver:
    """Observer of a flight."""

    def vehicle(self, name: str, tick: Tick) -> None: ...

    def host(self, name: str, tick: HostTick) -> None: ...

    def done(self, t: float) -> None: ...


def flown(name, *overrides):
    """Track, nearest to an obstacle [m], slowest to settle [s], touches."""
    experiment = load(find(name), overrides)
    rig = make_twin(experiment)
    assert rig.fly(NullObserver()).fault is None
    track, setups = rig.track(), list(experiment.vehicles.values())
    nearest = min(
        min(obstacle_distances(track, k, experiment.obstacles).values()) for k in range(len(setups))
    )
    settled = [
        settle_time(track.t, np.linalg.norm(track.states[:, k, :2] - setup.goal[:2], axis=1))
        for k, setup in enumerate(setups)
    ]
    slowest = None if None in settled else max(settled)
    return track, nearest, slowest, len(rig.twin.plant.touches)


def shifted(seed):
    """Obstacles and goals moved by up to 0.2 m."""
    rng = np.random.default_rng([seed, 3179])
    experiment = load(find("zhang2023_table_mpc"))
    moved = []
    for name, rock in experiment.obstacles.items():
        x, y = np.array(rock.position) + rng.uniform(-0.2, 0.2, 2)
        moved.append(f"obstacles.{name}.position=[{x:.3f}, {y:.3f}]")
    for name, setup in experiment.vehicles.items():
        x, y = np.array(setup.goal[:2]) + rng.uniform(-0.2, 0.2, 2)
        moved.append(f"vehicles.{name}.goal=[{x:.3f}, {y:.3f}, 0.0]")
    return moved


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_the_plan_keeps_clear_of_obstacles(seed):
    track, nearest, slowest, touches = flown("zhang2023_table_mpc", f"seed={seed}", "duration_s=80")
    assert touches == 0
    assert nearest >= 0.80
    assert slowest < 60.0
    assert smallest_separation(track) >= 0.80


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_and_where_they_stand_elsewhere(seed):
    _, nearest, slowest, touches = flown(
        "zhang2023_table_mpc", f"seed={seed}", "duration_s=80", *shifted(seed)
    )
    assert touches == 0
    assert nearest >= 0.80
    assert slowest < 60.0


@pytest.mark.slow
def test_lqr_is_blind_to_obstacles():
    # pushed by the obstacle, it would land or brake: no command explains that push
    rows = (
        "valve_leaks", "valve_leaks_or_weak", "valve_stuck_open", "valve_stuck_closed",
        "pulled_hard", "bumped", "thrust_or_mass", "pads_drag", "heading_off", "poses_late",
    )  # fmt: skip
    on = [f"faults.{row}.{what}" for row in rows for what in ("response=warn", "latched=false")]
    _, nearest, _, touches = flown("zhang2023_table_lqr", "duration_s=60", *on)
    assert touches > 0
    assert nearest < 0.52  # as near as the solid lets it come
