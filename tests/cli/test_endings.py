"""However a flight on the twin ends, its vehicles stand in the minute after."""

import json

import numpy as np
import pytest
from msgspec.structs import replace

from testbed.cli.exit_code import OK
from testbed.cli.replay import replay_run
from testbed.cli.run import RunOptions, run_experiment
from testbed.config import find, load
from testbed.logs.log_reader import LogReader
from testbed.rig.observers import NullObserver
from testbed.rig.twin import make_twin
from testbed.run.fly import fly_and_judge
from testbed.run.interrupt import Interrupt


class Kept(NullObserver):
    """Keeps every tick, those of the flight and those after it."""

    ticks = None  # a stop is heard at every tick

    def __init__(self):
        self.flown, self.after = [], []

    def vehicle(self, name, tick):
        (self.after if tick.inputs.vitals.end else self.flown).append((name, tick))


def ended(*overrides, name="zhang2023_table", stops=lambda rig: 0):
    """Fly, then come to rest."""
    rig, kept = make_twin(load(find(name), overrides)), Kept()

    def asked():
        return stops(rig)

    ending = rig.fly(kept, asked)
    return rig, ending, kept, rig.come_to_rest(ending, kept, asked)


def assert_safe(after):
    assert (after.contacts, after.air) == (0, "off")
    assert after.at_rest_s < 5.0
    assert {left.air for left in after.vehicles.values()} == {"off"}


def test_a_flight_that_ends_as_planned_brakes_and_lands():
    _, ending, kept, after = ended("duration_s=12")
    assert (ending.t, ending.fault) == (12.0, None)
    assert_safe(after)
    assert after.at_rest_s > 0.2  # it flew, and had to brake
    fired = [tick for _, tick in kept.after if any(tick.outputs.command.on_us)]
    assert fired
    assert {tick.inputs.armed for tick in (tick for _, tick in kept.after)} == {True}


def test_an_operators_stop_brakes_and_lands():
    _, ending, kept, after = ended(stops=lambda rig: int(rig.twin.now >= 11.0))
    assert ending.fault is None
    assert ending.t == pytest.approx(11.0)
    assert_safe(after)
    assert any(any(tick.outputs.command.on_us) for _, tick in kept.after)


def test_the_second_stop_shuts_valves_and_air_at_once():
    _, ending, kept, after = ended(stops=lambda rig: 2 * int(rig.twin.now >= 11.0))
    assert_safe(after)
    assert after.at_rest_s < 0.3
    assert len(kept.after) <= 3
    assert not any(any(tick.outputs.command.on_us) for _, tick in kept.after)
    assert ending.t == pytest.approx(11.0)


def test_the_second_stop_counts_also_while_the_first_one_brakes():
    _, _, kept, after = ended(stops=lambda rig: (rig.twin.now >= 11.0) + (rig.twin.now >= 11.25))
    assert_safe(after)
    assert [tick.inputs.armed for name, tick in kept.after if name == "sat1"] == [
        True, True, True, False,
    ]  # fmt: skip


@pytest.mark.parametrize(
    "kind", ["drop_mocap", "brown_out", "operator_gone", "stick_open", "freeze_mocap"]
)
def test_a_fault_ends_with_vehicles_that_stand(kind):
    inject = f'inject=[{{kind="{kind}",vehicle="sat2",at_s=10.03,jet=2}}]'
    _, ending, _, after = ended(inject, "duration_s=20")
    assert ending.fault is not None
    assert_safe(after)


def test_a_vehicle_without_poses_lands_when_its_prediction_is_worth_nothing_any_more():
    # the flight is over before the fault table has named the loss
    inject = 'inject=[{kind="drop_mocap",vehicle="sat2",at_s=11.8}]'
    _, ending, _, after = ended(inject, "duration_s=12")
    assert ending.fault is None
    assert_safe(after)


HOLDS = "flight.ending={after='hold',hold_s=8}"


def test_vehicles_hold_position_after_a_planned_end_then_they_stand():
    rig, ending, kept, after = ended("duration_s=12", HOLDS)
    assert (ending.fault, after.fault) == (None, None)
    assert (after.contacts, after.air) == (0, "off")
    assert after.at_rest_s < 12.0
    held = [tick for name, tick in kept.flown if name == "sat1" and tick.inputs.t >= 12.0]
    assert len(held) == 80
    assert any(any(tick.outputs.command.on_us) for tick in held[40:])  # the slope pulls
    track = rig.track()
    late = track.states[(track.t > 16.0) & (track.t < 20.0)]
    assert np.ptp(late[:, 0, :2], axis=0).max() < 0.01


def test_a_stop_ends_the_hold():
    _, _, kept, after = ended("duration_s=12", HOLDS, stops=lambda rig: int(rig.twin.now >= 13.0))
    assert (after.contacts, after.air, after.fault) == (0, "off", None)
    assert after.at_rest_s < 1.0 + 5.0
    assert max(tick.inputs.t for _, tick in kept.flown) < 13.0


def test_a_fault_ends_the_hold_and_is_told():
    lost = 'inject=[{kind="drop_mocap",vehicle="sat2",at_s=14.0}]'
    _, ending, _, after = ended("duration_s=12", HOLDS, lost)
    assert ending.fault is None
    assert (after.fault.id, after.fault.vehicle) == ("pose_lost", "sat2")
    assert (after.contacts, after.air) == (0, "off")


def test_low_pressure_ends_the_hold():
    empty = 'inject=[{kind="leak",vehicle="sat2",at_s=12.0,value=0.05}]'
    slow = "faults.leak.above=1e9"
    _, _, kept, after = ended("duration_s=12", HOLDS, empty, slow)
    assert (after.contacts, after.air, after.fault) == (0, "off", None)
    assert 14.0 < max(tick.inputs.t for _, tick in kept.flown) < 19.0


def test_a_stop_or_a_fault_in_flight_is_no_reason_to_hold():
    _, _, kept, after = ended("duration_s=12", HOLDS, stops=lambda rig: int(rig.twin.now >= 11.0))
    assert_safe(after)
    assert max(tick.inputs.t for _, tick in kept.flown) < 11.1


def test_with_a_law_on_board_they_hold_position_too():
    rig, _, _, after = ended("duration_s=12", HOLDS, "deploy.law=vehicle")
    assert (after.contacts, after.air) == (0, "off")
    track = rig.track()
    late = track.states[(track.t > 16.0) & (track.t < 20.0)]
    assert np.ptp(late[:, :, :2], axis=0).max() < 0.01


def test_where_pads_slide_farther_than_jets_brake_the_second_stop_brakes():
    icy = "vehicles.*.model.landing.friction=0.002"
    at = 11.0
    _, _, kept, after = ended(
        "duration_s=20", icy, stops=lambda rig: 2 * int(rig.twin.now >= at)
    )  # fmt: skip
    assert_safe(after)
    assert any(any(tick.outputs.command.on_us) for _, tick in kept.after)


DIES = 'inject=[{kind="kill_process",vehicle="sat1",at_s=9.03}]'


@pytest.mark.parametrize("board", ["model", "inproc"])
def test_the_board_of_a_dead_process_lands_the_vehicle(board):
    rig, _, _, after = ended(DIES, "duration_s=20", f"board={board}")
    assert_safe(after)
    landed = rig.twin.plant.landed[rig.twin.names.index("sat1")]
    assert 9.0 < landed < 9.0 + 0.1 + 0.15 + 0.1 + 1e-6  # a plan, the watchdog, a tick


def test_a_board_that_may_not_land_keeps_the_air_on_and_that_is_told():
    never = "vehicles.sat1.model.landing.by_board=false"
    _, _, _, after = ended(DIES, "duration_s=20", never)
    assert {name: left.air for name, left in after.vehicles.items()} == {
        "sat1": "on", "sat2": "off", "sat3": "off",
    }  # fmt: skip
    assert after.air == "on"
    assert after.vehicles["sat1"].at_rest_s is None


def test_firmware_in_the_loop_is_told_to_take_the_bearing_air_away():
    rig, ending, _, after = ended("board=inproc", "duration_s=2", name="hold")
    assert ending.fault is None
    assert_safe(after)
    assert not rig.boards["sat1"].board.bearing


def test_what_is_measured_of_the_flight_does_not_know_of_its_ending(tmp_path):
    experiment = load(find("zhang2023_table"), ["duration_s=6"])
    metrics = fly_and_judge(experiment, tmp_path)
    rig = make_twin(experiment)
    flown = Kept()
    rig.fly(flown)
    track = rig.track()
    assert metrics.duration_s == 6.0
    assert metrics.vehicles["sat1"].gas_g == 1e3 * rig.spent("sat1").gas
    assert metrics.vehicles["sat2"].valve_pulses == rig.spent("sat2").openings
    rows = list(LogReader(tmp_path / "log.mcap").read())
    times = {}
    for topic, stamp, _ in rows:
        times.setdefault(topic, []).append(stamp)
    assert len(times["/sat1/tick"]) == 60
    assert min(times["/sat1/ending"]) == 6_000_000_000
    assert track.t[-1] <= 6.0


def test_the_run_says_how_the_vehicles_were_left(tmp_path, capsys):
    code = run_experiment(
        "hold", ["duration_s=2", "criteria={}"], RunOptions(out=tmp_path / "a", as_json=True)
    )
    assert code == OK
    after = json.loads(capsys.readouterr().out)["after"]
    assert (after["contacts"], after["air"]) == (0, "off")
    assert after["at_rest_s"] < 1.0
    assert json.loads((tmp_path / "a" / "metrics.json").read_text())["after"] == after
    run_experiment(
        "hold", ["duration_s=2", "criteria={}"], RunOptions(out=tmp_path / "b", as_json=False)
    )
    assert f"sat1: at rest after {after['at_rest_s']:.1f} s, bearing air off" in (
        capsys.readouterr().out
    )


def test_the_ending_is_replayed_like_the_flight(tmp_path):
    overrides = ["duration_s=6", "criteria={}"]
    assert (
        run_experiment("zhang2023_table", overrides, RunOptions(out=tmp_path / "a", as_json=True))
        == OK
    )
    assert replay_run(tmp_path / "a", [], as_json=False) == OK


def test_a_count_of_stops_is_what_a_signal_makes():
    interrupt = Interrupt()
    interrupt._handle(2, None)
    interrupt._handle(2, None)
    assert interrupt.asked == 2


def test_an_arming_that_is_red_leaves_nothing_to_bring_to_rest():
    experiment = load(find("hold"), ["duration_s=1"])
    setup = experiment.vehicles["sat1"]
    outside = replace(setup, start=(2.99, 0.0, 0.0))
    rig = make_twin(replace(experiment, vehicles={"sat1": outside}))
    ending = rig.fly(NullObserver())
    assert rig.red
    assert rig.come_to_rest(ending, NullObserver()) is None
