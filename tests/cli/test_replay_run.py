"""`testbed replay`: every shipped experiment, flown and fed in again."""

import json
from pathlib import Path

import pytest

from testbed.config import SHIPPED

EXPERIMENTS = sorted(path.stem for path in (SHIPPED / "experiments").glob("*.toml"))


@pytest.fixture(autouse=True)
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


@pytest.mark.parametrize("experiment", EXPERIMENTS)
def test_every_shipped_experiment_is_bit_exact(testbed, experiment):
    testbed("run", experiment, "duration_s=3", "--out", "out")
    result = testbed("replay", "out", "--json")
    assert result.exit_code == 0, result.output
    verdict = json.loads(result.stdout)
    assert set(verdict) == {"ticks", "first_difference"}
    assert verdict["first_difference"] is None
    assert verdict["ticks"] >= 30


@pytest.mark.parametrize(
    ("change", "topic", "tick"),
    [
        ("controller.bandwidth=0.202", "/sat1/host", 2),  # the first with a pose is heard by then
        ("flight.tracker.bandwidth=0.808", "/sat1/tick", None),
        ("flight.estimator.nonsense=1", None, None),
    ],
)
def test_a_gain_changed_by_one_percent_is_found_at_once(testbed, change, topic, tick):
    testbed("run", "hold", "duration_s=3", "--out", "out")
    result = testbed("replay", "out", change, "--json")
    if topic is None:
        assert result.exit_code == 2
        return
    assert result.exit_code == 1
    first = json.loads(result.stdout)["first_difference"]
    assert first["topic"] == topic
    assert first["t"] == pytest.approx(0.1 * first["tick"])
    assert first["size"] > 0.0
    assert tick is None or first["tick"] == tick


def test_it_is_said_in_words(testbed):
    testbed("run", "hold", "duration_s=1", "--out", "out")
    # the law's ten, the vehicle's ten, and two in which it comes to rest
    assert "bit-exact: 22 ticks" in testbed("replay", "out/log.mcap").stdout
    result = testbed("replay", "out", "controller.bandwidth=0.3")
    assert result.exit_code == 1
    assert "different" in result.stdout
    assert "logged " in result.stdout


def test_what_cannot_be_replayed(testbed):
    testbed("run", "hold", "duration_s=1", "--out", "out")
    assert testbed("replay", "nowhere").exit_code == 2
    assert testbed("replay", "out", "deploy.law=vehicle").exit_code == 2
    Path("out/log.mcap").write_text("not a log at all")
    result = testbed("replay", "out")
    assert result.exit_code == 2
    assert "expected  an MCAP file" in result.stderr
