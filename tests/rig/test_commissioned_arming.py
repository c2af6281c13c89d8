"""Arming asks for the record of a commissioning where the experiment says so, on the table."""

import pytest
from msgspec.structs import replace

from testbed.config import find, load
from testbed.core.types import Accel, Health, Pose, State, Twist, Vitals
from testbed.flight.arming import Readiness
from testbed.net.commands import Ready, config_id
from testbed.rig.commissioning import record_of, save
from testbed.rig.wired import preflight

BOARD = "firmware 12345678 at /dev/ttyACM0"


@pytest.fixture
def red(tmp_path, monkeypatch):
    """Names and reasons of the failed checks of a vehicle that stands at its start."""
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))

    def check(experiment, *, hardware):
        setup = experiment.vehicles["sat1"]
        state = State(0.0, Pose(*setup.start), Twist(0.0, 0.0, 0.0), Accel(0.0, 0.0, 0.0), 0.0, 0)
        health = Health(0.0, setup.model.air.set_pressure, 0.0)
        ready = Readiness(0.0, state, 100.0, health, Vitals(), 0.0, True, {})
        answer = Ready(ready, config_id(experiment), BOARD)
        monkeypatch.setattr(preflight, "order", lambda *_: answer)
        monkeypatch.setattr(preflight, "trial_error", lambda *_: "")
        checks = preflight.Preflight(experiment, None, None, lambda: 1e12, hardware=hardware)
        return {c.name: c.reason for c in checks.checks() if c.reason}

    return check


def test_without_a_record_the_table_does_not_arm_and_the_bench_does(red):
    plain = load(find("hold"))
    asks = replace(plain, arming=replace(plain.arming, commissioned=True))
    assert red(plain, hardware=True) == {}
    assert red(asks, hardware=False) == {}
    assert list(red(asks, hardware=True)) == ["sat1 commissioned"]
    save(asks, "sat1", record_of(asks, "sat1", BOARD, "2026-01-01", "found"))
    assert red(asks, hardware=True) == {}
