"""A run on wires is armed by its supervisor, or it is said why not."""

import json
import threading
from contextlib import ExitStack, suppress
from pathlib import Path
from threading import Event

import pytest
from click.testing import CliRunner
from msgspec.structs import replace

from testbed.cli.exit_code import BAD_INPUT, FAULT, NOT_STARTED
from testbed.cli.main import main
from testbed.config import ConfigError, find, load
from testbed.core.codes import FaultId, FaultReport
from testbed.core.vehicle import Gauges
from testbed.logs.feed import LogFeed, SeenPhase
from testbed.logs.log_reader import LogReader
from testbed.net.commands import Refused, Start
from testbed.net.direct_stop import stop_directly
from testbed.net.keys import Keys
from testbed.net.roll_call import Enrolment, farewell, last_words
from testbed.net.session import NetworkError, Publisher, dial
from testbed.net.stop import stop_everything
from testbed.realtime.wall_clock import monotonic_ns
from testbed.rig.fault_latch import KILLED, FaultLatch
from testbed.rig.observers import NullObserver
from testbed.rig.twin import warm_up
from testbed.rig.wired.host import WireRig, loopback
from testbed.rig.wired.preflight import order

STOPPED = FaultReport(FaultId.STOPPED, "stopped by the operator")
ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(autouse=True)
def elsewhere(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    monkeypatch.chdir(tmp_path)


def run(*words):
    return CliRunner().invoke(main, ["run", "hold", *words])


def phases(out):
    book = LogReader(Path(out) / "log.mcap")
    return [one.message.phase for one in LogFeed(book).news() if isinstance(one.message, SeenPhase)]


def metrics(out):
    return json.loads((Path(out) / "metrics.json").read_text())


def test_a_red_check_is_named_and_nothing_is_armed():
    done = run("--rig", "bench", "arming.battery=13", "arming.clearance=1", "--out", "out")
    assert done.exit_code == NOT_STARTED
    assert "red: sat1 battery: 12.0 V" in done.output
    assert "not started: hold on the bench\n" in done.output
    assert "final error" not in done.output  # there is nothing to show
    battery = {"vehicle": "sat1", "id": "battery", "value": 12.0, "least": 13.0, "most": 16.0}
    assert metrics("out")["red"] == [battery | {"reason": "12.0 V", "at_reset": False}]
    assert metrics("out")["phase"] == "DISARMED"
    assert FaultLatch("bench", "lab", "").fault is None  # no valve could open


DIES = """
class Law:
    def force(self, own, neighbours, world, t):
        if abs(own.p[1] + 0.1) < 0.05:  # where it begins, not where it is tried
            raise ZeroDivisionError("as it was written")
        return 0.0 * own.p
"""


def test_a_law_that_dies_and_a_clock_that_is_not_known_are_red():
    Path("dies.py").write_text(DIES)
    law = 'controller={type="python", law="dies.py:Law"}'
    done = run("--rig", "bench", law, "criteria={}", "arming.clock_offset_s=1e-7", "--out", "out")
    assert done.exit_code == NOT_STARTED, done.output
    reasons = {one["id"]: one["reason"] for one in metrics("out")["red"]}
    assert reasons["law"].endswith("in force: ZeroDivisionError: as it was written")
    assert reasons["clock"].endswith("s from the host's")
    assert phases("out") == []


def test_setpoints_of_another_host_before_the_start_are_red():
    over = threading.Event()

    def intrude(endpoint):
        with dial(endpoint) as session:
            publisher = Publisher(session, "lab/sat1/setpoint")
            while not over.wait(0.1):
                publisher.send(b"anything at all")

    def way(endpoint):
        threading.Thread(target=intrude, args=(endpoint,)).start()
        return endpoint

    rig = WireRig(load(find("hold")), bench=True, relay=way)
    warm_up(rig.experiment)
    try:
        ending = rig.fly(NullObserver())
    finally:
        over.set()
    assert [one.words for one in rig.red] == ["sat1 session: messages of another session"]
    assert ending.t == 0.0


def test_a_forged_order_to_start_moves_nothing_and_the_flight_takes_place():
    over, answers = Event(), []

    def sample_plant(endpoint):
        with dial(endpoint) as session:
            while not over.wait(0.05):
                soon = monotonic_ns() + 10**9
                with suppress(NetworkError):
                    answers.append(order(session, Keys("lab"), "sat1", Start(7, soon, 7)))

    def way(endpoint):
        threading.Thread(target=sample_plant, args=(endpoint,)).start()
        return endpoint

    rig = WireRig(load(find("hold"), ["duration_s=1"]), bench=True, relay=way)
    warm_up(rig.experiment)
    try:
        ending = rig.fly(NullObserver())
    finally:
        over.set()
    assert ending.fault is None, (ending, rig.red)
    assert ending.t == pytest.approx(1.0)
    assert set(answers) == {Refused("the order to start is not from the host of this session")}


def test_the_boards_of_qemu_measure_nothing():
    measured = loopback(load(find("hold")), Path())
    assert measured.vehicles["sat1"].model.gauges.supply
    blind = loopback(load(find("hold"), ['board="qemu"']), Path())
    assert blind.vehicles["sat1"].model.gauges == Gauges(supply=False, battery=False)


def test_what_cannot_be_flown_on_wires_is_refused_before_anything_starts():
    slope = [[[0.0001234567, 0.0001]] * 120] * 120
    table = replace(
        load(find("hold")).table, tilt=replace(load(find("hold")).table.tilt, map=slope)
    )
    with pytest.raises(ConfigError, match="at most 256 kB"):
        WireRig(replace(load(find("hold")), table=table), bench=True)
    dies = 'inject=[{kind="kill_process", vehicle="sat1", event="near_edge", threshold=1}]'
    with pytest.raises(ConfigError, match="needs a time"):
        WireRig(load(find("hold"), [dies]), bench=True)
    with pytest.raises(ConfigError, match="no faults on the table"):
        WireRig(load(find("hold"), [dies]), bench=False)


def test_on_the_table_it_says_whom_it_waits_for():
    said = []
    rig = WireRig(loopback(load(find("hold")), Path()), bench=False, notify=said.append)
    ending = rig.fly(None, stopped=lambda: bool(said))
    assert said == ["waiting for sat1; start `testbed agent` on each computer"]
    assert (ending.t, ending.fault) == (0.0, None)


def test_an_operator_stops_a_host_that_waits_for_its_vehicles(capsys):
    experiment, codes = loopback(load(find("hold")), Path()), []
    endpoint = experiment.table.lab.network.endpoint
    rig = WireRig(
        experiment, bench=False, notify=lambda _: codes.append(stop_everything(endpoint, "lab"))
    )
    ending = rig.fly(NullObserver())
    assert (ending.t, ending.fault) == (0.0, STOPPED)
    assert codes == [0]
    assert capsys.readouterr().out == f"{endpoint}\n  sat1: does not start\n"


def test_a_stop_that_has_reached_a_vehicle_only_stops_its_host():
    experiment = loopback(load(find("zhang2023_table")), Path())
    endpoint = experiment.table.lab.network.endpoint

    def say(text):
        with dial(endpoint) as session:
            farewell(session, Keys("lab"), "sat2", "stopped", by_operator=True)

    ending = WireRig(experiment, bench=False, notify=say).fly(NullObserver())
    assert (ending.t, ending.fault) == (0.0, STOPPED)


def test_a_vehicle_that_is_stopped_before_the_start_tells_its_host():
    heard, found = set(), []

    def checked(checks):
        if not heard and any(one.id != "agent" for one in checks):  # it is there, and not armed
            endpoint = rig.experiment.table.lab.network.endpoint
            heard.update(stop_directly(endpoint, "lab", None, ["sat1"], "a", 60.0))
        found.extend(checks)

    rig = WireRig(load(find("hold"), ["arming.battery=13"]), bench=True, checked=checked)
    ending = rig.fly(NullObserver())
    assert heard == {"sat1"}
    assert (ending.t, ending.fault, rig.red) == (0.0, STOPPED, [])


def test_the_host_says_that_an_agent_has_ended_and_why():
    experiment, said = loopback(load(find("zhang2023_table")), Path()), []
    endpoint, keys = experiment.table.lab.network.endpoint, Keys("lab")
    with ExitStack() as stack:

        def say(text):
            said.append(text)
            if len(said) == 1:  # sat1 comes, sat2 ends before it is ready
                session = stack.enter_context(dial(endpoint))
                Enrolment(session, keys, "sat1")
                tokens.append(session.liveliness().declare_token(keys.of("sat1", "alive")))
                with suppress(OSError), last_words(session, keys, "sat2"):
                    raise OSError("no board at /dev/ttyACM7")
            if tokens and "waiting for sat2, sat3;" in text:
                tokens.pop().undeclare()

        tokens = []
        rig = WireRig(experiment, bench=False, notify=say)
        rig.fly(None, stopped=lambda: any("no longer on the network" in text for text in said))
    ended = "{0} has ended: {1}; start `testbed agent {0}` again"
    assert ended.format("sat2", "no board at /dev/ttyACM7") in said
    assert ended.format("sat1", "no longer on the network") in said


def test_the_run_after_a_fault_says_so_and_resets_it():
    first = run("--rig", "bench", "duration_s=3", "faults.battery_low.below=12.5", "--out", "one")
    assert first.exit_code == FAULT
    assert phases("one") == ["ARMED", "RUNNING", "FAULT"]
    assert FaultLatch("bench", "lab", "").fault.id == "battery_low"

    again = run("--rig", "bench", "duration_s=1", "--out", "two")
    assert again.exit_code != FAULT
    assert "battery_low" in again.output
    assert "--reset" in again.output
    assert phases("two") == ["DISARMED", "ARMED", "RUNNING", "STOPPED"]
    assert FaultLatch("bench", "lab", "").fault is None


def test_on_the_table_an_operator_must_be_there():
    done = run("--rig", "table", "--out", "out")
    assert done.exit_code == BAD_INPUT
    assert "--arm" in done.output
    assert not Path("out").exists()


def test_a_host_that_was_killed_is_a_fault_too():
    FaultLatch("table", "lab", "runs/yesterday").set()
    done = run("--rig", "table", "--arm", "--out", "out")
    assert done.exit_code == BAD_INPUT
    assert KILLED.text in " ".join(done.output.split())


def test_on_the_twin_the_same_checks_are_asked():
    done = run("arming.battery=13", "--out", "out")
    assert done.exit_code == NOT_STARTED
    assert "red: sat1 battery: 12.0 V" in done.output
    assert phases("out") == []
