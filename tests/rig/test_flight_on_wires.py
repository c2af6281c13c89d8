"""Short flights on the bench: real bytes, real firmware, real processes; nothing left behind."""

import json
import os
import signal
import subprocess
import sys
import threading
import time
from contextlib import suppress
from pathlib import Path

import psutil
import pytest
from msgspec.structs import replace

from testbed.config import ConfigError, find, load
from testbed.core.codes import FaultId
from testbed.net.direct_stop import stop_directly
from testbed.net.keys import Keys
from testbed.net.session import dial
from testbed.net.stop import stop_everything
from testbed.rig.chain import make_agent
from testbed.rig.observers import NullObserver
from testbed.rig.twin import make_twin, warm_up
from testbed.rig.wired import stop_requests
from testbed.rig.wired.host import WireRig
from testbed.rig.wired.wired_flight import HostFlight

AGENT = "testbed.rig.wired.agent_process"
ROOT = Path(__file__).resolve().parents[2]


class Noted(NullObserver):
    """Keeps every tick."""

    def __init__(self):
        self.ticks, self.hosts, self.after = {}, {}, []

    def vehicle(self, name, tick):
        if tick.inputs.vitals.end:
            self.after.append(tick)
            return
        self.ticks.setdefault(name, []).append(tick)

    def host(self, name, tick):
        self.hosts.setdefault(name, []).append(tick)


def listening(pid):
    """Addresses at which a process, and what it has started, can be reached."""
    found = set()
    process = psutil.Process(pid)
    for one in (process, *process.children(recursive=True)):
        for connection in one.net_connections("inet"):
            if connection.status in (psutil.CONN_LISTEN, psutil.CONN_NONE):
                found.add(connection.laddr.ip)
    return found


def fly(name, *overrides, when_started=lambda rig: None, stops=lambda rig: 0):
    """On the bench, in this process as host."""
    experiment = load(find(name), overrides)
    warm_up(experiment)
    rig = WireRig(experiment, bench=True)
    noted, met = Noted(), {}

    def started(rig):
        met["addresses"] = {ip for pid in rig.children.values() for ip in listening(pid)}
        met["addresses"] |= listening(os.getpid())
        met["pids"] = dict(rig.children)
        met["links"] = list(rig.experiment.table.lab.serial.ports.values())
        when_started(rig)

    rig.on_start = started
    met["asked_ns"] = time.time_ns()
    ending = rig.fly(noted, lambda: stops(rig))
    return rig, ending, noted, met


@pytest.fixture(scope="module")
def flown():
    return fly("hold", "duration_s=3")


def test_it_is_flown_to_the_end(flown):
    rig, ending, noted, _ = flown
    assert ending.fault is None
    assert ending.t == 3.0
    assert len(noted.hosts["sat1"]) == 30
    assert len(noted.ticks["sat1"]) >= 29  # the last one may be under way
    assert rig.results.ended["sat1"].fault is None
    assert rig.touches == []


def test_time_0_is_after_arming_and_not_when_the_command_began(flown):
    rig, ending, _, met = flown
    assert met["asked_ns"] < rig.began_ns
    assert rig.began_ns + round(1e9 * ending.t) <= time.time_ns()


def test_after_it_the_vehicle_stands(flown):
    rig, ending, noted, _ = flown
    after = rig.come_to_rest(ending, NullObserver())
    assert (after.contacts, after.air) == (0, "off")
    assert after.at_rest_s < 3.0
    assert rig.results.ended["sat1"].air == "off"  # as its board says
    assert rig.results.report.left_as["sat1"] == ("SAFE", [])
    assert noted.after[-1].outputs.air_off
    assert all(tick.inputs.armed for tick in noted.after)


def test_the_firmware_moves_the_vehicle(flown):
    rig, _, noted, _ = flown
    assert rig.results.report.openings["sat1"] > 3
    planned = sum(1 for tick in noted.ticks["sat1"] for on in tick.outputs.command.on_us if on)
    last = 8  # a tick may be under way at the end, and the brake begins within a frame of it
    assert rig.spent("sat1").openings <= planned + last  # those of the flight
    assert (
        rig.spent("sat1").openings < rig.results.report.openings["sat1"]
    )  # and of the brake after it
    track = rig.track()
    assert track.states[-1, 0, 1] > -0.1 + 0.002  # from y = -0.1 m towards 0
    assert track.t[-1] <= 3.0


def test_the_log_has_the_valves_as_the_board_drove_them(flown):
    rig, _, _, _ = flown
    told = [(valves.t, valves.mask) for name, valves in rig.valves(since=-1.0)]
    seen = [
        (1e-9 * (1000 * at - rig.results.epoch_ns), mask)
        for at, mask in rig.results.report.edges["sat1"]
    ]
    flying = [edge for edge in seen if edge[0] < told[-1][0] + 1e-3]
    assert [mask for _, mask in told] == [mask for _, mask in flying]
    for (t, _), (at, _) in zip(told, flying, strict=True):
        assert t == pytest.approx(at, abs=0.02)  # two readings of the board's clock


def test_the_log_has_how_the_wires_are(flown):
    rig, _, _, _ = flown
    paces = [pace for _, _, pace in rig.paces()]
    assert len(paces) >= 29
    assert paces[-1].setpoints_heard >= 28
    assert paces[-1].setpoint_delay_s > 0.0
    assert paces[-1].round_trip_s > 0.0
    assert rig.loop[1] > 0.0


def test_poses_may_come_on_the_network():
    rig, ending, noted, _ = fly("hold", "duration_s=1", "table.lab.mocap.system=zenoh")
    assert ending.fault is None
    assert sum(len(tick.inputs.samples) for tick in noted.ticks["sat1"]) > 50
    assert rig.results.ended["sat1"].counts.lost_frames < 20


@pytest.mark.parametrize(
    ("bench", "board", "words"),
    [(True, "inproc", "host or qemu"), (True, "unicorn", "host or qemu"),
     (False, "qemu", "its boards are the lab")],
)  # fmt: skip
def test_a_board_that_this_rig_cannot_have_is_refused(bench, board, words):
    with pytest.raises(ConfigError, match=words):
        WireRig(load(find("hold"), [f"board={board}"]), bench=bench)


@pytest.mark.parametrize("bench", [True, False])
def test_more_jets_than_a_board_drives_are_refused(bench):
    experiment = load(find("hold"))
    setup = experiment.vehicles["sat1"]
    more = replace(setup.model, jets=(*setup.model.jets, setup.model.jets[0]))
    nine = replace(experiment, vehicles={"sat1": replace(setup, model=more)})
    with pytest.raises(ConfigError, match="at most 8 jets"):
        WireRig(nine, bench=bench)


def test_a_twin_has_no_board_in_real_time():
    with pytest.raises(ConfigError, match="on the twin"):
        make_twin(load(find("hold"), ["board=qemu"]))


def test_what_the_metrics_say(flown):
    rig, _, _, _ = flown
    wires = rig.wires()
    assert wires["commands"].sent >= 28
    assert (wires["commands"].rejected, wires["commands"].expired) == (0, 0)
    assert wires["lateness_p99_ms"] > 0.0
    assert wires["pose_to_valve_p99_ms"] >= wires["pose_to_valve_p50_ms"] > 0.0
    assert "firmware" in wires["board"]


def test_the_same_chain_gives_the_same_outputs(flown):
    rig, _, noted, _ = flown
    agent = make_agent(rig.experiment, "sat1")
    for tick in noted.ticks["sat1"]:
        assert agent.step(tick.inputs) == tick.outputs


def test_no_socket_listens_beyond_this_machine(flown):
    assert flown[3]["addresses"] == {"127.0.0.1"}


def assert_nothing_is_left(met):
    assert [name for name, pid in met["pids"].items() if psutil.pid_exists(pid)] == []
    assert [link for link in met["links"] if Path(link).exists()] == []
    assert not Path(met["links"][0]).parent.exists()


def test_nothing_is_left(flown):
    assert_nothing_is_left(flown[3])


def test_three_vehicles_with_the_law_on_board_and_a_bad_network():
    rig, ending, noted, met = fly(
        "zhang2023_table", "duration_s=2", "deploy.law=vehicle",
        "table.lab.impairment={loss=0.05, delay_s=0.02, spread_s=0.01}",
    )  # fmt: skip
    assert ending.fault is None
    assert set(noted.ticks) == {"sat1", "sat2", "sat3"}
    heard = noted.ticks["sat2"][-1].inputs.neighbours
    assert set(heard) == {"sat1", "sat3"}
    assert rig.wires()["commands"].sent == 0  # setpoints are made on board
    assert_nothing_is_left(met)


def test_an_operator_says_stop(capsys):
    endpoint = []

    def stop_later(rig):
        endpoint.append(rig.experiment.table.lab.network.endpoint)
        threading.Timer(2.0, stop_everything, (endpoint[0], "lab")).start()

    rig, ending, _, met = fly("hold", "duration_s=30", when_started=stop_later)
    assert ending.fault.words == "stopped by the operator"
    assert ending.t < 20.0
    assert rig.results.report.left_as["sat1"] == ("SAFE", [])
    assert "  sat1: stops\n" in capsys.readouterr().out
    after = rig.come_to_rest(ending, NullObserver())
    assert (after.contacts, after.air) == (0, "off")
    assert after.at_rest_s < 3.0
    assert_nothing_is_left(met)


def test_a_stop_after_the_vehicles_have_ended_finds_them_at_rest(monkeypatch, capsys):
    """Their processes are gone, and the host is still there while the twin's server ends."""
    codes = []

    class EndsSlowly(WireRig):
        def _end_children(self, children):
            children.end(list(self.experiment.vehicles))
            endpoint = self.experiment.table.lab.network.endpoint
            codes.append(stop_everything(endpoint, "lab"))
            super()._end_children(children)

    monkeypatch.setitem(globals(), "WireRig", EndsSlowly)
    _, ending, _, met = fly("hold", "duration_s=1")
    assert ending.fault is None
    assert codes == [0]
    assert "  sat1: had ended, bearing air off\n" in capsys.readouterr().out
    assert_nothing_is_left(met)


def test_a_vehicle_is_stopped_without_its_host(monkeypatch):
    """The host hears the same stop after the vehicle's report of it: that is no second stop."""
    late, asked = [], stop_requests.StopRequests()
    monkeypatch.setattr(stop_requests, "AGAIN_NS", -1)  # in the host: however late
    monkeypatch.setattr("testbed.rig.wired.host.StopRequests", lambda: asked)

    def stop_later(rig):
        endpoint = rig.experiment.table.lab.network.endpoint
        operator = dial(endpoint, 5.0)
        threading.Timer(2.0, stop_directly, (endpoint, "lab", None, ["sat1"], "a", 5.0)).start()
        note = rig.results.note_tick

        def noted(name, flown):
            note(name, flown)
            if flown.stops and not late:
                late.append(operator)
                operator.put(Keys("lab").stop, b"a")

        rig.results.note_tick = noted

    rig, ending, noted, met = fly("hold", "duration_s=30", when_started=stop_later)
    late[0].close()
    assert ending.fault.words == "stopped by the operator"
    assert ending.t < 20.0
    assert asked.times == 1  # 2 would shut valves and air at once
    assert noted.after
    after = rig.come_to_rest(ending, NullObserver())
    assert (after.contacts, after.air) == (0, "off")
    assert_nothing_is_left(met)


@pytest.mark.parametrize(("hold_s", "stop_s"), [(30.0, 4.0), (1.5, 60.0)])
def test_vehicles_hold_position_until_a_stop_or_for_their_time(hold_s, stop_s):
    holds = f"flight.ending={{after='hold',hold_s={hold_s}}}"
    rig, ending, noted, met = fly("hold", "duration_s=2", holds, stops=lambda r: r.now > stop_s)
    assert (ending.fault, ending.t) == (None, 2.0)
    held = [tick for tick in noted.ticks["sat1"] if tick.inputs.t >= 2.0]
    assert held[-1].inputs.t == pytest.approx(min(stop_s, 2.0 + hold_s), abs=0.5)
    assert rig.results.ended["sat1"].fault is None
    after = rig.come_to_rest(ending, NullObserver())
    assert (after.contacts, after.air) == (0, "off")
    assert_nothing_is_left(met)


def test_the_board_of_a_killed_process_lands_the_vehicle():
    """So late that the twin's server has to wait for it: 2.5 s after the watchdog."""
    late = "vehicles.sat1.model.landing={speed=0.01,slope=0.0,room=0.0265}"
    dies = 'inject=[{kind="kill_process",vehicle="sat1",at_s=1.5}]'
    rig, ending, _, met = fly("hold", "duration_s=30", dies, late)
    assert ending.fault.id is FaultId.VEHICLE_SILENT
    assert rig.results.report.left_as["sat1"] == ("SAFE", ["WATCHDOG"])
    after = rig.come_to_rest(ending, NullObserver())
    assert (after.contacts, after.air) == (0, "off")
    assert after.at_rest_s is not None
    assert_nothing_is_left(met)


def test_a_board_whose_process_is_killed_has_no_power():
    """Its valves are shut, the bearing valve, too: nothing drifts."""

    def kill_soon(rig):
        boards = psutil.Process(rig.children["twin"]).children()
        board = next(one for one in boards if "fd:" in one.cmdline()[-1])
        threading.Timer(3.0, board.kill).start()

    rig, ending, _, met = fly("hold", "duration_s=30", when_started=kill_soon)
    assert ending.fault.id == "board_silent"
    after = rig.come_to_rest(ending, NullObserver())
    assert (after.contacts, after.air) == (0, "off")
    assert after.at_rest_s is not None
    assert_nothing_is_left(met)


def test_the_second_ctrl_c_shuts_valves_and_air_without_a_brake():
    rig, ending, noted, met = fly("hold", "duration_s=30", stops=lambda rig: 2 * (rig.now > 1.5))
    assert ending.fault is None
    assert ending.t < 20.0
    after = rig.come_to_rest(ending, NullObserver())
    assert (after.contacts, after.air) == (0, "off")
    assert not any(tick.inputs.armed for tick in noted.after)
    assert_nothing_is_left(met)


def test_a_stop_after_a_ctrl_c_shuts_valves_and_air(monkeypatch):
    asked, orders = stop_requests.StopRequests(), []
    monkeypatch.setattr(stop_requests, "AGAIN_NS", -1)  # in the host: however soon
    monkeypatch.setattr("testbed.rig.wired.host.StopRequests", lambda: asked)
    ordered = HostFlight._stop_all

    def stop_all(flight, reason, *, at_once=False):
        orders.append(at_once)
        ordered(flight, reason, at_once=at_once)

    monkeypatch.setattr(HostFlight, "_stop_all", stop_all)

    def ctrl_c_and_stop(rig):
        if rig.now > 1.0:
            asked.count(b"a")
        return int(rig.now > 1.0)

    _, ending, _, met = fly("hold", "duration_s=30", stops=ctrl_c_and_stop)
    assert ending.t < 20.0
    assert orders[0]
    assert_nothing_is_left(met)


def test_stop_knows_nothing_and_loads_nothing(tmp_path):
    program = (
        "import sys; from click.testing import CliRunner; from testbed.cli.main import main;"
        "from testbed.net import stop; stop.DEFAULT = 'tcp/127.0.0.1:1';"  # no flight of a tester
        "code = CliRunner().invoke(main, ['stop']).exit_code;"
        "print(code, sorted({'numpy', 'numba', 'rerun', 'msgspec'} & set(sys.modules)))"
    )
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True,
        env=os.environ | {"PYTHONPATH": str(ROOT), "XDG_RUNTIME_DIR": str(tmp_path)},
    )  # fmt: skip
    assert done.stdout.split(" ", 1) == ["1", "[]\n"]


@pytest.fixture
def start(tmp_path):
    """`testbed run --rig bench` in a process of its own, until its vehicle flies."""
    started = []

    def start():
        env = os.environ | {
            "PYTHONPATH": str(ROOT),
            "XDG_RUNTIME_DIR": str(tmp_path),
            "XDG_STATE_HOME": str(tmp_path),
        }
        process = subprocess.Popen(
            [sys.executable, "-m", "testbed", "run", "hold", "--rig", "bench",
             "--out", str(tmp_path / "out")],
            stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=env,
            start_new_session=True,
        )  # fmt: skip
        started.append(process)
        for _ in range(12000):
            tree = process_tree(process)
            ready = [one for one in tree if AGENT in words_of(one)]
            if ready and any("pts" in fd for fd in files(ready[0])):  # it has its board
                return process, tree
            assert process.poll() is None, process.communicate()
            threading.Event().wait(0.01)
        pytest.fail("two minutes are enough")

    yield start
    for process in started:
        process.kill()
        process.communicate()


def words_of(process):
    try:
        return process.cmdline()
    except psutil.Error:  # it has just ended
        return []


def files(process):
    found = []
    for path in Path(f"/proc/{process.pid}/fd").iterdir():
        with suppress(FileNotFoundError):  # closed meanwhile
            found.append(str(path.readlink()))
    return found


def process_tree(process):
    try:
        return psutil.Process(process.pid).children(recursive=True)
    except psutil.NoSuchProcess:  # the caller finds out how it ended
        return []


def assert_gone(processes):
    _, alive = psutil.wait_procs(processes, timeout=60)
    assert [one.cmdline() for one in alive] == []


def test_ctrl_c_ends_everything(start, tmp_path):
    process, tree = start()
    process.send_signal(signal.SIGINT)
    stdout, stderr = process.communicate(timeout=60)
    assert process.returncode == 130, (stdout, stderr)
    assert json.loads((tmp_path / "out" / "metrics.json").read_text())["completed"] is False
    assert_gone(tree)


@pytest.mark.parametrize("stopped", [False, True], ids=["", "with a stopped child"])
def test_a_killed_parent_takes_everything_along(start, stopped):
    process, tree = start()
    agent = next(one for one in tree if AGENT in one.cmdline())
    ports = [fd for fd in files(agent) if "pts" in fd]
    if stopped:
        agent.suspend()
    process.kill()
    assert_gone(tree)
    assert ports
