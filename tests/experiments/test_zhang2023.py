"""zhang2023's table experiment keeps its promises, for seeds and layouts nobody tuned for."""

from pathlib import Path

import numpy as np
import pytest

from testbed.config import SHIPPED, ConfigError, Experiment, find, load
from testbed.metrics.run_metrics import Metrics
from testbed.run.fly import fly_and_judge

SEEDS = range(6)  # benchmarks/zhang2023_table.py flies twenty in each mode
SHORT_PERIOD = ("flight.jet_period_s=0.05", 'flight.modulator={ type = "sigma_delta" }')


def fly(experiment: Experiment, folder: Path) -> Metrics:
    return fly_and_judge(experiment, folder)


def assert_promises(metrics: Metrics, impulse_ns: float, *, tracks: bool) -> None:
    assert metrics.fault is None
    assert metrics.completed
    assert metrics.contacts == 0
    for name, m in metrics.vehicles.items():
        assert m.min_obstacle_distance_m >= 0.80, name
        assert m.settle_s is not None, name
        assert m.settle_s <= 90.0, name
        assert m.hold_rms_m <= 0.001, name
        assert m.heading_rms_deg <= 0.1, name
        assert m.impulse_ns <= impulse_ns, name
        assert m.filtered_ns <= 0.01 * m.impulse_ns, name  # left alone by the filter
        if tracks:
            assert m.track_rms_m <= 0.0015, name
        else:
            assert m.track_rms_m is None, name
    assert all(metrics.criteria.values())


@pytest.mark.parametrize("seed", SEEDS)
def test_reference_mode(seed: int, tmp_path: Path) -> None:
    experiment = load(find("zhang2023_table"), [f"seed={seed}"])
    assert_promises(fly(experiment, tmp_path), 14.0, tracks=True)


@pytest.mark.parametrize("seed", SEEDS)
def test_wrench_mode(seed: int, tmp_path: Path) -> None:
    experiment = load(find("zhang2023_table_wrench"), [f"seed={seed}"])
    assert_promises(fly(experiment, tmp_path), 20.0, tracks=False)


@pytest.mark.parametrize("seed", SEEDS)
def test_wrench_mode_at_a_short_jet_period(seed: int, tmp_path: Path) -> None:
    experiment = load(find("zhang2023_table_wrench"), [f"seed={seed}", *SHORT_PERIOD])
    assert_promises(fly(experiment, tmp_path), 20.0, tracks=False)


def shifted(name: str, seed: int) -> Experiment:
    """The experiment with obstacles and goals moved by up to 0.25 m, drawn until it is valid."""
    rng = np.random.default_rng(seed)
    while True:
        shipped = load(find(name))
        overrides = [f"seed={seed}"]
        for key, rock in shipped.obstacles.items():
            x, y = np.array(rock.position) + rng.uniform(-0.25, 0.25, 2)
            overrides.append(f"obstacles.{key}.position=[{x}, {y}]")
        for key, setup in shipped.vehicles.items():
            x, y = np.array(setup.goal[:2]) + rng.uniform(-0.25, 0.25, 2)
            overrides.append(f"vehicles.{key}.goal=[{x}, {y}, 0.0]")
        try:
            experiment = load(find(name), overrides)
        except ConfigError:
            continue
        places = [p[:2] for s in experiment.vehicles.values() for p in (s.start, s.goal)]
        obstacles = [rock.position for rock in experiment.obstacles.values()]
        # nearer than this the layout itself asks for less than the danger radius
        if min(np.hypot(*np.subtract(p, q)) for p in places for q in obstacles) >= 0.9:
            return experiment


@pytest.mark.parametrize("seed", range(100, 104))
@pytest.mark.parametrize("name", ["zhang2023_table", "zhang2023_table_wrench"])
def test_shifted_layouts(name: str, seed: int, tmp_path: Path) -> None:
    metrics = fly(shifted(name, seed), tmp_path)
    assert metrics.contacts == 0
    assert metrics.fault is None
    for m in metrics.vehicles.values():
        assert m.min_obstacle_distance_m >= 0.80
        assert m.settle_s is not None
        assert m.settle_s <= 90.0
        assert m.hold_rms_m <= 0.001
        assert m.heading_rms_deg <= 0.1


def test_pd_hits_an_obstacle_and_says_so(tmp_path: Path) -> None:
    metrics = fly(load(find("zhang2023_table_pd")), tmp_path)
    assert metrics.contacts > 0
    assert metrics.fault is not None  # pushed, and not by its jets: no wonder
    assert "contact with o1 (" in metrics.fault
    assert metrics.criteria["max_contacts"] is False
    assert metrics.criteria["clear_of_obstacles"] is False


@pytest.mark.parametrize("mode", ["reference", "wrench"])
def test_the_safety_filter_stops_pd_short_of_the_obstacle(mode: str, tmp_path: Path) -> None:
    overrides = ["flight.barrier.on=true", f"guidance.mode={mode}"]
    metrics = fly(load(find("zhang2023_table_pd"), overrides), tmp_path)
    assert metrics.fault is None
    assert metrics.contacts == 0
    assert metrics.criteria["clear_of_obstacles"] is True
    assert metrics.vehicles["sat3"].filtered_ns > 0.0


@pytest.mark.parametrize("name", ["zhang2023_table", "zhang2023_table_wrench"])
def test_swapped_goals_keep_clear_of_obstacles_and_of_each_other(name: str, tmp_path: Path) -> None:
    swapped = ["vehicles.sat1.goal=[-1.247,1.836,0.0]", "vehicles.sat3.goal=[1.818,1.915,0.0]"]
    metrics = fly(load(find(name), swapped), tmp_path)
    assert metrics.fault is None
    assert metrics.contacts == 0
    assert metrics.criteria["clear_of_obstacles"] is True


def test_smc_is_slower_and_peaks_higher_than_sotsmc(tmp_path: Path) -> None:
    flown = {}
    for name in ("zhang2023_table", "zhang2023_table_smc"):
        (tmp_path / name).mkdir()
        flown[name] = fly(load(find(name)), tmp_path / name)
    first, second = flown["zhang2023_table_smc"].vehicles, flown["zhang2023_table"].vehicles
    assert all(flown["zhang2023_table_smc"].criteria.values())
    for name in first:
        assert first[name].settle_s > second[name].settle_s
        assert first[name].max_force_n > second[name].max_force_n


@pytest.mark.parametrize("name", sorted(p.stem for p in (SHIPPED / "experiments").glob("*.toml")))
def test_every_shipped_experiment_flies_two_seconds(name: str, tmp_path: Path) -> None:
    metrics = fly(load(find(name), ["duration_s=2.0"]), tmp_path)
    assert metrics.fault is None
    assert metrics.completed
    assert metrics.contacts == 0
