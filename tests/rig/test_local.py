"""A twin and a host on one machine, while the table file names a lab's addresses already."""

from pathlib import Path

import pytest
from click.testing import CliRunner

from testbed.cli.main import BAD_INPUT, main
from testbed.config import find, load
from testbed.core.lab import Lab
from testbed.rig.wired.local import local, loopback
from testbed.rig.wired.server import TableServer, pty_path

LAB = [
    "table.lab.mocap={server='192.168.1.10', interface='192.168.1.3', group='239.255.42.99'}",
    "table.lab.network={endpoint='tls/192.168.1.2:7450', keys='keys/host'}",
    "table.lab.serial.ports={sat1='/dev/ttyACM0'}",
]


@pytest.fixture
def in_a_lab():
    return load(find("hold"), LAB)


def test_local_replaces_every_address_of_the_lab(in_a_lab):
    there = local(in_a_lab).table.lab
    assert there == Lab()
    assert local(in_a_lab).vehicles == in_a_lab.vehicles


def test_a_bench_keeps_the_keys_and_takes_free_ports(in_a_lab, tmp_path):
    there = loopback(in_a_lab, tmp_path).table.lab
    assert there.network.keys == "keys/host"
    assert there.network.endpoint.startswith("tls/127.0.0.1:")
    assert (there.mocap.server, there.mocap.interface) == ("127.0.0.1", "127.0.0.1")
    assert there.serial.ports == {"sat1": str(tmp_path / "serial-sat1")}


def test_the_folder_that_was_asked_for_is_where_the_ports_appear(in_a_lab, tmp_path):
    assert pty_path(in_a_lab, "sat1", None) == Path("/dev/ttyACM0")
    assert pty_path(in_a_lab, "sat1", tmp_path) == tmp_path / "serial-sat1"
    assert pty_path(load(find("hold")), "sat1", None) == Path("serial-sat1")


def test_a_twin_of_a_lab_makes_its_port_there_and_listens_here(in_a_lab, tmp_path):
    bench = loopback(in_a_lab, Path("/dev"))  # with free ports: tests run beside each other
    with TableServer(bench, tmp_path):
        assert (tmp_path / "serial-sat1").is_symlink()
        assert not Path("/dev/serial-sat1").exists()


def test_local_is_for_the_table(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    done = CliRunner().invoke(main, ["run", "hold", "--local"])
    assert done.exit_code == BAD_INPUT
    assert "--rig table" in done.output
    assert list(tmp_path.iterdir()) == []
