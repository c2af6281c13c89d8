"""`testbed replay` names the stage: a change is planted in each one."""

import pytest
from msgspec.structs import replace as changed

import testbed
from testbed.logs.log_reader import LogReader, log_of
from testbed.logs.replay import replay
from testbed.logs.stage import DUTIES
from testbed.rig.chain import make_agent

CHANGES = [  # stage, place in Parameters, factor
    ("estimator", "model.mass", 1.01),
    ("tracker", "gains.heading_bandwidth", 1.01),
    ("safety filter", "limits.speed", 0.2),
    ("monitor", "rows.high", 1e-3),
    ("braking", "brakes.decel", 0.9),
    ("gate", "gate.max_speed", 0.05),
    (DUTIES, "jets.effect", 1.01),
    (DUTIES, "planner.modulator.min_on", 4.0),
]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    experiment = testbed.load(
        "configs/scenarios/step.toml", "guidance.mode=wrench", "duration_s=12", "criteria={}",
        'inject=[{kind="raise_law", vehicle="sat1", at_s=9.0}]',
    )  # fmt: skip
    run = testbed.fly(experiment, log=tmp_path_factory.mktemp("run") / "a")
    assert run.fault is not None
    return run.folder


def planted(part, place, factor):
    """Nested named tuples with one number changed."""
    name, _, rest = place.partition(".")
    inner = getattr(part, name)
    return part._replace(**{name: planted(inner, rest, factor) if rest else inner * factor})


@pytest.mark.parametrize(("stage", "place", "factor"), CHANGES)
def test_a_change_in_the_chain_is_named(folder, stage, place, factor):
    agent = make_agent(testbed.load(folder / "config.toml"), "sat1")
    agent.params = planted(agent.params, place, factor)
    rows = (row for row in LogReader(log_of(folder)).read() if not row.topic.endswith("/host"))
    first = replay(rows, {"sat1": agent.step}, {"sat1": None}).first_difference
    assert (first.stage, first.topic.rpartition("/")[2]) == (stage, "tick")


def test_only_the_times_of_the_pulses_point_to_the_modulation(folder):
    agent = make_agent(testbed.load(folder / "config.toml"), "sat1")

    def shifted(inputs):
        out = agent.step(inputs)
        command = out.command
        if not any(command.on_us):
            return out
        later = tuple(one + 1 for one in command.offset_us)
        return changed(out, command=changed(command, offset_us=later))

    rows = (row for row in LogReader(log_of(folder)).read() if not row.topic.endswith("/host"))
    assert replay(rows, {"sat1": shifted}, {"sat1": None}).first_difference.stage == "modulation"


def test_a_change_of_the_law_is_named(tmp_path):
    run = testbed.fly(testbed.load("hold", "duration_s=2", "criteria={}"), log=tmp_path / "a")
    first = testbed.replay(run, "controller.bandwidth=0.25").first_difference
    assert (first.stage, first.topic) == ("guidance", "/sat1/host")


def test_a_run_that_ended_with_a_fault_is_replayed_to_its_end(tmp_path):
    """The last tick is disarmed, and the law is not called."""
    fault = 'inject=[{kind="stick_open", vehicle="sat1", at_s=2.0, jet=2}]'
    run = testbed.fly(
        testbed.load("hold", "duration_s=8", "criteria={}", fault), log=tmp_path / "a"
    )
    assert run.fault is not None
    assert testbed.replay(run).first_difference is None
