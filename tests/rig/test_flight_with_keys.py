"""A flight on the bench in a lab with keys: a watcher stops no vehicle, an operator all."""

import threading

from click.testing import CliRunner

from testbed.cli.keys import lab_keys
from testbed.config import find, load
from testbed.net.keys import Keys
from testbed.net.session import NetworkError, ask, dial
from testbed.net.stop import FAILED, stop_everything
from testbed.rig.observers import NullObserver
from testbed.rig.twin import warm_up
from testbed.rig.wired.host import WireRig

TLS = ['table.lab.network.endpoint="tls/127.0.0.1:7450"']


def fly(folder, *overrides, when_started=lambda rig: None):
    where = f'table.lab.network.keys="{folder / "host"}"'
    experiment = load(find("hold"), [*TLS, where, *overrides])
    warm_up(experiment)
    rig = WireRig(experiment, bench=True)
    rig.on_start = when_started
    return rig, rig.fly(NullObserver())


def make(folder, *arguments):
    done = CliRunner().invoke(lab_keys, [str(folder), "--host", "127.0.0.1", *arguments])
    assert done.exit_code == 0, done.output


def test_a_watcher_stops_no_vehicle_and_an_operator_all(tmp_path):
    make(tmp_path, "--vehicle", "sat1", "--operator", "anna", "--watcher", "screen")
    told = []

    def meanwhile(endpoint):
        told.append(stop_everything(endpoint, "lab", tmp_path / "watcher-screen"))
        with dial(endpoint, 1.0, tmp_path / "watcher-screen") as screen:
            try:
                told.append(ask(screen, Keys("lab").of("sat1", "order"), b"", 0.5))
            except NetworkError as error:
                told.append(str(error))
        told.append(stop_everything(endpoint, "lab", tmp_path / "operator-anna"))

    def later(rig):
        network = rig.experiment.table.lab.network
        assert network.endpoint.startswith("tls/127.0.0.1:")
        threading.Timer(2.0, meanwhile, (network.endpoint,)).start()

    rig, ending = fly(tmp_path, "duration_s=30", when_started=later)
    assert ending.fault.words == "stopped by the operator"
    assert 1.0 < ending.t < 20.0
    assert told == [FAILED, "no answer on lab/sat1/order: no party is there", 0]
    assert rig.results.report.left_as["sat1"] == ("SAFE", [])
    assert set(dict(rig.truth())) == {"sat1"}  # as the table's own keys allow


def test_a_vehicle_without_keys_is_not_waited_for(tmp_path):
    make(tmp_path, "--operator", "anna")
    _, ending = fly(tmp_path, "duration_s=2")
    assert "no keys for sat1" in ending.fault.text
    assert "lab-keys" in ending.fault.text
