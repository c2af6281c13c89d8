"""`testbed stop` reaches a vehicle without its host."""

import json
import socket
from contextlib import closing

import pytest

from ports import free_port
from testbed.net import stop as stopping
from testbed.net.certificate_authority import Wanted, make_keys
from testbed.net.direct_stop import GROUP, PORTS, StopListener, ports, stop_directly
from testbed.net.flight_note import noted
from testbed.net.stop import FAILED, OK, stop_everything


@pytest.fixture
def endpoint():
    return f"tcp/127.0.0.1:{free_port()}"


@pytest.fixture
def keys(tmp_path):
    parties = [("host", "host"), ("vehicle", "sat1"), ("vehicle", "sat2"), ("operator", "anna"),
               ("watcher", "screen")]  # fmt: skip
    for lab in ("lab", "other"):
        make_keys(
            tmp_path / lab,
            Wanted(lab, "tls/127.0.0.1:7450", [], parties, days=10),
            force=False,
        )
    return tmp_path


class Vehicle:
    """A vehicle that listens, and the stops it has heard."""

    def __init__(self, name, endpoint, keys=None):
        self.stops = []
        self.listener = StopListener(name, "lab", endpoint, keys, self.stops.append)
        self.close = self.listener.close


def asked(port, **message):
    """The answer to one datagram; None: there is none."""
    with closing(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) as line:
        line.settimeout(0.3)
        line.sendto(json.dumps({"lab": "lab", **message}).encode(), ("127.0.0.1", port))
        try:
            return json.loads(line.recv(4096))
        except TimeoutError:
            return None


def test_all_vehicles_of_a_host_stop_without_it(endpoint):
    with closing(Vehicle("sat1", endpoint)) as one, closing(Vehicle("sat2", endpoint)) as two:
        assert stop_directly(endpoint, "lab", None, (), "a", 0.3) == {"sat1", "sat2"}
        assert one.stops == two.stops == ["a"]
        assert stop_directly(endpoint, "lab", None, ("sat1", "sat2"), "b", 9.0) == {"sat1", "sat2"}
        assert one.stops == two.stops == ["a", "b"]


def test_vehicles_of_another_lab_or_host_are_left_alone(endpoint):
    with closing(Vehicle("sat1", endpoint)) as one:
        assert stop_directly(endpoint, "another", None, (), "a", 0.1) == set()
        elsewhere = f"tcp/127.0.0.1:{ports(endpoint)[-1]}"
        assert stop_directly(elsewhere, "lab", None, (), "a", 0.1) == set()
        assert one.stops == []


def test_a_lost_answer_is_sent_again_and_the_stop_counts_once(endpoint):
    with closing(Vehicle("sat1", endpoint)) as one:
        port = one.listener.port
        nonce = asked(port, ask="who")["nonce"]
        stop = {"ask": "stop", "vehicle": "sat1", "nonce": nonce, "id": "a"}
        assert asked(port, **stop)["stops"] == nonce
        assert asked(port, **stop)["stops"] == nonce
        assert one.stops == ["a"]
        asked(port, ask="who")
        fresh = asked(port, ask="who")["nonce"]
        assert asked(port, **{**stop, "nonce": fresh})["stops"] == fresh
        assert asked(port, **stop) is None  # recorded, and sent again later
        assert one.stops == ["a", "a"]


@pytest.mark.parametrize(
    "data",
    [b"", b"\xff", b"[]", b"[" * 4000, b'{"lab": "lab"}', b'{"lab": "lab", "ask": "stop"}',
     b'{"lab": "lab", "ask": "stop", "vehicle": "sat1", "nonce": null, "id": 1}', bytes(4096)],
)  # fmt: skip
def test_garbage_is_dropped(endpoint, data):
    with closing(Vehicle("sat1", endpoint)) as one:
        with closing(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) as line:
            line.sendto(data, ("127.0.0.1", one.listener.port))
        assert stop_directly(endpoint, "lab", None, ("sat1",), "a", 5.0) == {"sat1"}
        assert one.stops == ["a"]


def test_without_keys_only_this_machine_is_heard(endpoint):
    with closing(Vehicle("sat1", endpoint)) as one:
        assert one.listener._socket.getsockname()[0] == "127.0.0.1"


def test_more_vehicles_than_ports_are_refused(endpoint):
    some = []
    try:
        with pytest.raises(OSError, match="in use"):
            some.extend(Vehicle(f"sat{k}", endpoint) for k in range(PORTS + 1))
    finally:
        for one in some:
            one.close()


# Keys


@pytest.mark.parametrize("who", ["operator-anna", "host"])
def test_operator_and_host_may_stop(endpoint, keys, who):
    with closing(Vehicle("sat1", endpoint, keys / "lab/vehicle-sat1")) as one:
        stopped = stop_directly(endpoint, "lab", keys / "lab" / who, ("sat1",), "a", 5.0)
        assert stopped == {"sat1"}
        assert one.stops == ["a"]


@pytest.mark.parametrize(
    "who", ["lab/watcher-screen", "lab/vehicle-sat2", "other/operator-anna", None]
)
def test_others_may_not(endpoint, keys, who):
    with closing(Vehicle("sat1", endpoint, keys / "lab/vehicle-sat1")) as one:
        folder = keys / who if who else None
        assert stop_directly(endpoint, "lab", folder, ("sat1",), "a", 0.2) == set()
        assert one.stops == []


def test_a_signature_counts_for_one_vehicle_and_one_number(endpoint, keys):
    from testbed.net.direct_stop import _demand
    from testbed.net.signature import Signer

    signer = Signer(keys / "lab/operator-anna")
    with closing(Vehicle("sat1", endpoint, keys / "lab/vehicle-sat1")) as one:
        port = one.listener.port
        nonce = asked(port, ask="who")["nonce"]
        stop = {"ask": "stop", "vehicle": "sat1", "nonce": nonce, "id": "a"}
        for signed in (("sat2", nonce, "a"), ("sat1", "0" * 32, "a"), ("sat1", nonce, "b")):
            one.listener._ignored.clear()
            assert asked(port, **stop, **signer.sign(_demand("lab", *signed))) is None
        one.listener._ignored.clear()
        right = asked(port, **stop, **signer.sign(_demand("lab", "sat1", nonce, "a")))
        assert right["stops"] == nonce
        assert one.stops == ["a"]


def test_a_false_receipt_is_not_believed(endpoint, keys):
    """A party that is not the vehicle answers in its place."""
    with closing(Vehicle("sat1", endpoint, keys / "other/vehicle-sat1")) as one:
        one.listener._may = lambda *_: True
        folder = keys / "lab/operator-anna"
        assert stop_directly(endpoint, "lab", folder, ("sat1",), "a", 0.3) == set()


def test_a_vehicle_on_the_network_joins_the_group(endpoint, keys, monkeypatch):
    """Its host is on another machine; here the other machine is this one."""
    from testbed.net import direct_stop

    joined = []

    class Line(socket.socket):
        def setsockopt(self, level, option, value):
            if option == socket.IP_ADD_MEMBERSHIP:
                joined.append(socket.inet_ntoa(value[:4]))

    monkeypatch.setattr(direct_stop.socket, "socket", Line)
    monkeypatch.setattr(direct_stop, "is_local", lambda _: False)
    monkeypatch.setattr(direct_stop, "ANY", "127.0.0.1")
    with closing(Vehicle("sat1", endpoint, keys / "lab/vehicle-sat1")):
        assert joined == [GROUP]


# The command


@pytest.fixture
def here(tmp_path, monkeypatch):
    """A machine on which nothing flies."""
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    monkeypatch.delenv("SUDO_UID", raising=False)
    monkeypatch.setattr(stopping, "own_keys", lambda: tmp_path / "home")
    monkeypatch.setattr(stopping, "DEFAULT", f"tcp/127.0.0.1:{free_port()}")


def test_a_host_that_hangs_does_not_keep_its_vehicles_from_stopping(here, capsys):
    """The system accepts for a process that is stopped; nothing ever answers."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        endpoint = f"tcp/127.0.0.1:{server.getsockname()[1]}"
        with (
            closing(Vehicle("sat1", endpoint)) as one,
            noted(endpoint, "lab", vehicles=["sat1"], name="hold"),
        ):
            assert stop_everything(None, "lab") == OK
            assert len(one.stops) == 1
    said = capsys.readouterr().out
    assert "  sat1: stops\n" in said
    assert "without the host" in said


def test_a_vehicle_that_is_missing_is_named(here, capsys):
    with socket.create_server(("127.0.0.1", 0)) as server:
        endpoint = f"tcp/127.0.0.1:{server.getsockname()[1]}"
        with (
            closing(Vehicle("sat1", endpoint)),
            noted(endpoint, "lab", vehicles=["sat1", "sat2"], name="hold"),
        ):
            assert stop_everything(None, "lab") == FAILED
    assert "  sat2: did not answer\n" in capsys.readouterr().out


def test_without_a_host_and_a_note_the_default_ports_are_tried(here, capsys):
    with closing(Vehicle("sat1", stopping.DEFAULT)) as one:
        assert stop_everything(None, "lab") == OK
        assert len(one.stops) == 1
    assert "  sat1: stops\n" in capsys.readouterr().out
