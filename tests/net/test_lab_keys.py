"""With the lab's keys each party may do what the list says, and strangers nothing.

All of it with real certificates that `testbed lab-keys` made, over real TLS on loopback.
"""

import hashlib
import json
import ssl
import stat
import tomllib
from contextlib import ExitStack
from itertools import count
from pathlib import Path
from types import SimpleNamespace

import msgspec
import pytest
import zenoh
from click.testing import CliRunner

from patience import wait_for
from ports import free_port
from testbed.cli.keys import lab_keys
from testbed.config import ConfigError, find, load
from testbed.core.lab import Network
from testbed.net import flight_note
from testbed.net import stop as stopping
from testbed.net.access import ACCESS, control, open_lab, read_access
from testbed.net.certificate_authority import Wanted, make_keys
from testbed.net.commands import Accepted, Answer, Refused, Start, Stop
from testbed.net.credentials import CredentialsError, is_local, read_credentials
from testbed.net.flight_note import noted
from testbed.net.keys import Keys
from testbed.net.session import (
    NetworkError,
    Publisher,
    Subscriber,
    answer_to,
    answers,
    ask,
    dial,
    listen,
)
from testbed.net.stop import FAILED, OK, stop_everything
from testbed.rig.wired.command_server import CommandServer

BLIND = SimpleNamespace(ready=lambda: Refused("sees nothing"))  # a lookout

KEYS = Keys("lab")
TICKET = 77
VEHICLES = ["sat1", "sat2"]
UNWELCOME = ["watcher-screen", "vehicle-sat2", "table"]
START = msgspec.msgpack.encode(Start(7, 10**9, TICKET))
LATER = b"later"  # said until it is heard, so it may be heard again


def lab(folder, *arguments):
    done = CliRunner().invoke(lab_keys, [str(folder), *arguments])
    assert done.exit_code == 0, done.output
    return done.stdout


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("lab") / "keys"
    everybody = ["--vehicle", "sat1", "--vehicle", "sat2", "--operator", "anna"]
    port = str(free_port())
    lab(folder, "--host", "127.0.0.1", "--port", port, *everybody, "--watcher", "screen")
    return folder


@pytest.fixture(scope="module")
def endpoint(folder):
    return read_credentials(folder / "host").endpoint


class Commanded:
    """What a vehicle has been told to do."""

    def __init__(self, session, name):
        self.commands = CommandServer(session, KEYS, name, "a board", BLIND, TICKET)
        self.shut = 0
        self.commands.take_off(self.close)
        self.setpoints = Subscriber(session, KEYS.of(name, "setpoint"))
        self.leases = Subscriber(session, KEYS.lease)

    def close(self):
        self.shut += 1

    def nothing(self):
        words = {
            data
            for subscriber in (self.setpoints, self.leases)
            for _, data in subscriber.received()
        }
        return (
            self.commands.starts.empty() and self.commands.stop_reason is None and self.shut == 0
            and words <= {LATER}
        )  # fmt: skip


class LabOnLoopback:
    """A host with its list, and everybody's sessions, opened when they are asked for."""

    def __init__(self, stack, folder, endpoint):
        self._stack, self._folder, self._endpoint = stack, folder, endpoint
        self._sessions = {}
        network = Network(endpoint=endpoint, keys=str(folder / "host"))
        session, self.warned = open_lab(network, VEHICLES)
        self.host = stack.enter_context(session)
        self.kept = [
            answer_to(self.host, KEYS.experiment, lambda _: b"an experiment"),
            answer_to(self.host, KEYS.clock, lambda _: b"12345678"),
            answer_to(self.host, KEYS.ended, lambda _: b"{}"),
        ]

    def __getitem__(self, who):
        if who not in self._sessions:
            session = dial(self._endpoint, 1.0, self._folder / who)
            self._sessions[who] = self._stack.enter_context(session)
        return self._sessions[who]

    def settle(self, *subscribers):
        """Wait until each subscriber hears a later message than all before."""
        for key, subscriber in subscribers:
            publisher, heard = Publisher(self.host, key), []

            def again(publisher=publisher, subscriber=subscriber, heard=heard):
                publisher.send(LATER)
                heard.extend(data for _, data in subscriber.received())
                return LATER in heard

            wait_for(again)
            yield [data for data in heard if data != LATER]


@pytest.fixture
def rig(folder, endpoint):
    with ExitStack() as stack:
        yield LabOnLoopback(stack, folder, endpoint)


def answer(data):
    return msgspec.msgpack.decode(data, type=Answer)


# Who may


def test_the_host_arms_and_an_operator_stops(rig):
    told = Commanded(rig["vehicle-sat1"], "sat1")
    order = KEYS.of("sat1", "order")
    wait_for(lambda: told.commands is not None and _answers(rig.host, order))
    with pytest.raises(NetworkError, match="no party is there"):
        ask(rig["operator-anna"], order, START, wait_s=0.5)
    assert told.commands.starts.empty()
    assert answer(ask(rig.host, order, START)) == Accepted("a board")
    assert told.commands.starts.get_nowait() == Start(7, 10**9, TICKET)
    halt = msgspec.msgpack.encode(Stop("enough"))
    assert answer(ask(rig.host, order, halt)) == Accepted("a board")
    assert told.commands.stop_reason == "enough"
    assert len(answers(rig["operator-anna"], KEYS.stop, 0.5)) == 1
    wait_for(lambda: told.shut > 0)  # here no loop obeys: it is shut without one
    shut = told.shut
    stops = count()  # each with an id of its own: a copy of a stop is not a second one

    def stopped_again():
        rig["operator-anna"].put(KEYS.stop, b"stop %d" % next(stops))
        return told.shut > shut

    wait_for(stopped_again)


def test_a_flight_that_obeys_a_stop_is_not_shut_before_it_rests(rig):
    told = Commanded(rig["vehicle-sat1"], "sat1")
    told.commands.obey()
    wait_for(lambda: _answers(rig.host, KEYS.of("sat1", "order")))
    assert len(answers(rig["operator-anna"], KEYS.stop, 0.5)) == 1
    assert told.commands.stop_reason == "stopped by the operator"
    assert told.shut == 0
    at_once = msgspec.msgpack.encode(Stop("twice", at_once=True))
    ask(rig.host, KEYS.of("sat1", "order"), at_once)
    assert told.shut == 1


def _answers(session, key):
    """Whether somebody answers there: also with an error, to a question that is none."""
    return bool(list(session.get(key, payload=b"", timeout=1.0)))


def test_commands_come_from_the_host_alone(rig):
    told = Commanded(rig["vehicle-sat1"], "sat1")
    subscribers = [(KEYS.of("sat1", "setpoint"), told.setpoints), (KEYS.lease, told.leases)]
    assert list(rig.settle(*subscribers)) == [[], []]
    for who in (*UNWELCOME, "operator-anna"):
        for key in (KEYS.of("sat1", "setpoint"), KEYS.lease, "lab/sat1/*", "lab/**", "**"):
            rig[who].put(key, b"forged")
        _passed_on(rig, who)
    assert list(rig.settle(*subscribers)) == [[], []]


def _passed_on(rig, who):
    """What this party has said is through the host: a question after it is answered or refused."""
    try:
        ask(rig[who], KEYS.experiment, wait_s=1.0)
    except NetworkError:
        return


@pytest.mark.parametrize("who", UNWELCOME)
def test_others_can_neither_arm_nor_stop(rig, who):
    told = Commanded(rig["vehicle-sat1"], "sat1")
    order = KEYS.of("sat1", "order")
    wait_for(lambda: _answers(rig.host, order))
    for key in (order, "lab/*/order", "lab/**", "**"):
        for question in (START, msgspec.msgpack.encode(Stop("forged"))):
            with pytest.raises(NetworkError, match="no party is there"):
                ask(rig[who], key, question, wait_s=0.5)
    assert len(answers(rig[who], KEYS.stop, 0.5)) == 0
    for key in (KEYS.stop, "lab/operator/*", "lab/**", "**"):
        rig[who].put(key, b"stop")
    _passed_on(rig, who)
    list(rig.settle((KEYS.lease, told.leases)))
    assert told.nothing()


def test_no_other_party_speaks_for_a_vehicle(rig):
    state = KEYS.of("sat1", "state")
    subscriber = Subscriber(rig.host, state)
    for who in ("vehicle-sat2", "watcher-screen", "operator-anna", "table"):
        rig[who].put(state, who.encode())
        token = rig[who].liveliness().declare_token(KEYS.of("sat1", "alive"))
        with pytest.raises(NetworkError):
            ask(rig[who], KEYS.of("sat1", "nothing"), wait_s=0.2)
        del token
    assert list(rig.host.liveliness().get(KEYS.of("sat1", "alive"), timeout=1.0)) == []
    own = Publisher(rig["vehicle-sat1"], state)
    heard = []

    def said():
        own.send(b"sat1")
        heard.extend(data for _, data in subscriber.received())
        return heard

    wait_for(said)
    assert set(heard) == {b"sat1"}


def test_a_vehicle_cannot_take_the_orders_of_another(rig):
    caught = []
    kept = [
        answer_to(rig["vehicle-sat2"], KEYS.of("sat1", "order"), caught.append),
        answer_to(rig["vehicle-sat2"], KEYS.of("sat2", "order"), lambda data: b"mine"),
    ]
    wait_for(lambda: _answers(rig.host, KEYS.of("sat2", "order")))
    with pytest.raises(NetworkError, match="no party is there"):
        ask(rig.host, KEYS.of("sat1", "order"), START, wait_s=0.5)
    assert caught == []
    del kept


def test_a_watcher_watches_what_may_be_watched(rig):
    screen, sat1 = rig["watcher-screen"], rig["vehicle-sat1"]
    told = Commanded(sat1, "sat1")
    seen = {word: Subscriber(screen, KEYS.of("sat1", word)) for word in ("state", "tick", "event")}
    hidden = {
        key: Subscriber(screen, key) for key in (KEYS.of("sat1", "setpoint"), KEYS.stop, "lab/**")
    }
    mouths = {word: Publisher(sat1, KEYS.of("sat1", word)) for word in seen}
    setpoint, got = Publisher(rig.host, KEYS.of("sat1", "setpoint")), dict.fromkeys(seen, 0)
    heard = []

    def all_seen():
        setpoint.send(b"a command")
        for word, publisher in mouths.items():
            publisher.send(b"a word")
            got[word] += len(seen[word].received())
        heard.extend(told.setpoints.received())
        return all(got.values()) and heard

    wait_for(all_seen)
    told_of = {data for subscriber in hidden.values() for _, data in subscriber.received()}
    assert told_of <= {b"a word"}  # its own session passes on to ** what it may hear
    assert ask(screen, KEYS.experiment) == b"an experiment"
    with pytest.raises(NetworkError):
        ask(screen, KEYS.clock, wait_s=0.3)


def test_the_ones_struck_out_are_shut_out(folder, endpoint, tmp_path):
    access = read_access(folder / "host")
    left = [one for one in access.party if one.name != "anna"]
    rules = control(msgspec.structs.replace(access, party=left), KEYS)
    with (
        listen(endpoint, folder / "host", rules),
        dial(endpoint, 1.0, folder / "vehicle-sat1") as sat1,
        dial(endpoint, 1.0, folder / "operator-anna") as anna,
    ):
        told = Commanded(sat1, "sat1")
        with dial(endpoint, 1.0, folder / "host") as host:
            wait_for(lambda: _answers(host, KEYS.of("sat1", "order")))
        assert len(answers(anna, KEYS.stop, 0.5)) == 0
        with pytest.raises(NetworkError):
            ask(anna, KEYS.of("sat1", "order"), START, wait_s=0.3)
        assert told.commands.starts.empty()


# Who gets in


def client(endpoint, tls):
    """A Zenoh client of somebody who does not use our software."""
    return zenoh.open(
        zenoh.Config.from_json5(
            json.dumps({
                "mode": "client",
                "scouting": {"multicast": {"enabled": False}},
                "connect": {"endpoints": [endpoint], "timeout_ms": 300, "exit_on_failure": True},
                "transport": {"link": {"tls": tls}},
            })
        )
    )  # fmt: skip


def test_without_a_certificate_no_party_gets_in(rig, folder, endpoint):
    root = str(folder / "host" / "authority.pem")
    for tls in ({"root_ca_certificate": root}, {}):
        with pytest.raises(zenoh.ZError):
            client(endpoint, tls)
    for bare in (endpoint.replace("tls/", "tcp/"), endpoint.replace("tls/", "ws/")):
        with pytest.raises(zenoh.ZError):
            client(bare, {})
    assert ask(rig["operator-anna"], KEYS.experiment) == b"an experiment"  # and nothing is broken
    assert ask(rig["operator-anna"], KEYS.ended) == b"{}"


def test_a_certificate_of_another_authority_is_none(rig, tmp_path, folder, endpoint):
    lab(tmp_path / "keys", "--host", "127.0.0.1", "--operator", "anna")
    with pytest.raises(NetworkError, match="no host answers"):
        dial(endpoint, 0.0, tmp_path / "keys" / "operator-anna")
    mixed = tmp_path / "keys" / "operator-anna"  # who believes our host, and is not believed
    (mixed / "authority.pem").write_bytes((folder / "host" / "authority.pem").read_bytes())
    with pytest.raises(NetworkError, match="no host answers"):
        dial(endpoint, 0.3, mixed)


def test_an_expired_certificate_is_none(rig, tmp_path, folder, endpoint):
    copied = tmp_path / "keys"
    (copied / "authority").mkdir(parents=True)
    (copied / "host").mkdir()
    for name in ("private.key", "certificate.pem"):
        (copied / "authority" / name).write_bytes((folder / "authority" / name).read_bytes())
    wanted = Wanted("lab", endpoint, [], [("operator", "anna")], -0.5)  # backdated by a day
    (credentials,) = make_keys(copied, wanted, force=False)
    assert "expired" in credentials.ending
    with pytest.raises(NetworkError, match="not expired"):
        dial(endpoint, 0.3, copied / "operator-anna")


@pytest.mark.parametrize("who", ["watcher-screen", "vehicle-sat2", "operator-anna"])
def test_no_party_passes_for_the_host(folder, who):
    where = f"tls/127.0.0.1:{free_port()}"
    with listen(where, folder / who), pytest.raises(NetworkError, match="no host answers"):
        dial(where, 0.3, folder / "vehicle-sat1")


def test_a_host_at_another_address_is_not_believed(tmp_path):
    lab(tmp_path, "--host", "elsewhere.lab", "--vehicle", "sat1")
    where = f"tls/127.0.0.2:{free_port()}"  # its certificate is for 127.0.0.1
    with listen(where, tmp_path / "host"), pytest.raises(NetworkError, match="no host answers"):
        dial(where, 0.3, tmp_path / "vehicle-sat1")


# Without keys


@pytest.mark.parametrize(
    ("endpoint", "local"),
    [
        ("tcp/127.0.0.1:7450", True), ("tcp/[::1]:7450", True), ("tcp/localhost:7450", True),
        ("udp/127.3.2.1:7450?rel=0", True), ("unixsock-stream//tmp/lab.sock", True),
        ("tcp/0.0.0.0:7450", False), ("tcp/[::]:7450", False), ("tcp/192.168.1.2:7450", False),
        ("tcp/localhost.evil.org:7450", False), ("tcp/:7450", False), ("", False),
        ("tcp/127.0.0.1.evil.org:7450", False), ("tcp/127.0.0.1", False),
    ],
)  # fmt: skip
def test_what_is_on_this_machine(endpoint, local):
    assert is_local(endpoint) is local


def test_without_keys_no_socket_reaches_beyond_this_machine():
    for act in (listen, dial):
        with pytest.raises(NetworkError, match="without keys only this machine"):
            act("tcp/0.0.0.0:7450")
    with pytest.raises(ConfigError, match="keys"):
        load(find("hold"), ['table.lab.network.endpoint="tcp/0.0.0.0:7450"'])


def test_keys_ask_for_an_endpoint_that_uses_them(folder):
    with pytest.raises(NetworkError, match="expected tls/127"):
        listen("tcp/127.0.0.1:7450", folder / "host")
    with pytest.raises(ConfigError, match="tls/127"):
        load(find("hold"), [f"table.lab.network.keys={folder / 'host'}"])


# The folders


def test_private_keys_are_private(folder):
    found = sorted(folder.rglob("private.key"))
    assert len(found) == 7  # authority, host, table, two vehicles, operator, watcher
    assert {stat.S_IMODE(key.stat().st_mode) for key in found} == {0o600}
    assert {stat.S_IMODE(key.parent.stat().st_mode) for key in found} == {0o700}


def test_a_key_that_others_can_read_is_not_used(tmp_path):
    lab(tmp_path, "--host", "127.0.0.1")
    key = tmp_path / "host" / "private.key"
    key.chmod(0o640)
    with pytest.raises(CredentialsError, match=r"mode 640, expected 600.*chmod"):
        read_credentials(tmp_path / "host")


def test_fingerprints_and_expiry_are_what_the_certificates_say(folder):
    listed = {p.name: p for p in read_access(folder / "host").party}
    for who in ("host", "vehicle-sat1", "operator-anna"):
        text = (folder / who / "certificate.pem").read_text()
        digest = hashlib.sha256(ssl.PEM_cert_to_DER_cert(text)).hexdigest()
        credentials = read_credentials(folder / who)
        assert credentials.fingerprint.replace(":", "").lower() == digest
        assert listed[credentials.name].fingerprint == credentials.fingerprint
        inside = ssl._ssl._test_decode_cert(str(folder / who / "certificate.pem"))
        ends = ssl.cert_time_to_seconds(inside["notAfter"])
        assert credentials.expires.startswith(_date(ends))
    shown = lab(folder)
    assert all(p.fingerprint in shown and p.expires[:10] in shown for p in listed.values())


def _date(seconds):
    import datetime

    return datetime.datetime.fromtimestamp(seconds, datetime.UTC).isoformat()


def test_keys_are_not_overwritten_unless_that_is_said(tmp_path):
    lab(tmp_path, "--host", "127.0.0.1", "--vehicle", "sat1")
    key = tmp_path / "vehicle-sat1" / "private.key"
    root = (tmp_path / "authority" / "private.key").read_bytes()
    before = key.read_bytes()
    again = CliRunner().invoke(lab_keys, [str(tmp_path), "--vehicle", "sat1"])
    assert again.exit_code == 2
    assert "--force" in again.stderr
    assert key.read_bytes() == before
    lab(tmp_path, "--vehicle", "sat1", "--force")
    assert key.read_bytes() != before
    assert (tmp_path / "authority" / "private.key").read_bytes() == root
    assert [p.name for p in read_access(tmp_path / "host").party] == ["host", "table", "sat1"]


def test_renewing_gives_all_parties_new_keys_of_the_same_authority(tmp_path):
    lab(tmp_path, "--host", "127.0.0.1", "--vehicle", "sat1", "--watcher", "screen")
    before = {p.name: p.fingerprint for p in read_access(tmp_path / "host").party}
    lab(tmp_path, "--renew", "--host", "::1", "--port", "7451")
    after = {p.name: p.fingerprint for p in read_access(tmp_path / "host").party}
    assert before.keys() == after.keys()
    assert not before.items() & after.items()
    assert read_credentials(tmp_path / "vehicle-sat1").endpoint == "tls/[::1]:7451"
    assert list(tmp_path.glob(".*")) == []


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ([], "expected --host"), (["--host", "a b"], "a host name"),
        (["--host", "127.0.0.1", "--vehicle", "../sat1"], "letters, digits"),
        (["--host", "127.0.0.1", "--vehicle", ""], "letters, digits"),
    ],
)  # fmt: skip
def test_what_cannot_be_made_is_said(tmp_path, arguments, words):
    done = CliRunner().invoke(lab_keys, [str(tmp_path / "keys"), *arguments])
    assert done.exit_code == 2
    assert words in done.stderr
    assert not (tmp_path / "keys").exists()


def test_an_authority_that_cannot_be_read_is_said(tmp_path):
    lab(tmp_path, "--host", "127.0.0.1")
    (tmp_path / "authority" / "private.key").write_text("rubbish")
    done = CliRunner().invoke(lab_keys, [str(tmp_path), "--vehicle", "sat1"])
    assert done.exit_code == 2
    assert "restore its backup" in done.stderr


@pytest.mark.parametrize(
    "text",
    [
        "", "[]", "5", "{}", '{"lab": 1}', "\x00", "[" * 10_000,
        '{"lab": "l", "endpoint": "e", "role": "king", "name": "n", "fingerprint": "f",'
        ' "expires": "2030-01-01T00:00:00+00:00"}',
        '{"lab": "l", "endpoint": "e", "role": "host", "name": "n", "fingerprint": "f",'
        ' "expires": "soon"}',
    ],
)  # fmt: skip
def test_credentials_with_a_missing_field_are_refused(tmp_path, text):
    lab(tmp_path, "--host", "127.0.0.1")
    (tmp_path / "host" / "credentials.json").write_text(text)
    with pytest.raises(CredentialsError, match="lab-keys"):
        read_credentials(tmp_path / "host")


@pytest.mark.parametrize(
    "text", ["", "lab = 1", 'lab = "lab"\nendpoint = "e"\nparty = [{}]', "\x00", "a = [[[["]
)
def test_a_list_that_says_nothing_is_refused(tmp_path, text):
    lab(tmp_path, "--host", "127.0.0.1")
    (tmp_path / "host" / ACCESS).write_text(text)
    with pytest.raises(CredentialsError, match=r"access\.toml"):
        read_access(tmp_path / "host")


def test_the_host_opens_with_its_own_keys_for_its_own_vehicles(folder, endpoint):
    with pytest.raises(NetworkError, match="no keys for sat9"):
        open_lab(Network(endpoint=endpoint, keys=str(folder / "host")), ["sat1", "sat9"])
    with pytest.raises(NetworkError, match="expected the host's"):
        open_lab(Network(endpoint=endpoint, keys=str(folder / "operator-anna")), VEHICLES)
    with pytest.raises(NetworkError, match="of the lab 'lab'"):
        open_lab(Network(lab="other", endpoint=endpoint, keys=str(folder / "host")), VEHICLES)
    with pytest.raises(NetworkError, match="no keys in"):
        open_lab(Network(endpoint=endpoint, keys=str(folder / "nobody")), VEHICLES)


def test_keys_that_expire_soon_are_spoken_of(tmp_path):
    where = str(free_port())
    lab(tmp_path, "--host", "127.0.0.1", "--port", where, "--vehicle", "sat1", "--days", "20")
    lab(tmp_path, "--watcher", "screen")
    network = Network(endpoint=f"tls/127.0.0.1:{where}", keys=str(tmp_path / "host"))
    session, warned = open_lab(network, ["sat1"])
    session.close()
    assert [words.split(" expire")[0] for words in warned] == [
        "the keys of host", "the keys of table", "the keys of vehicle-sat1",
    ]  # fmt: skip


# Stop


@pytest.fixture
def nowhere(tmp_path, monkeypatch):
    """No flight on this machine, and no keys at home."""
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    monkeypatch.setattr(stopping, "own_keys", lambda: tmp_path / "home")
    monkeypatch.setattr(stopping, "DEFAULT", f"tcp/127.0.0.1:{free_port()}")
    return tmp_path


def test_stop_with_an_operators_keys(rig, folder, nowhere, monkeypatch, capsys):
    told = Commanded(rig["vehicle-sat1"], "sat1")
    wait_for(lambda: _answers(rig.host, KEYS.of("sat1", "order")))
    assert stop_everything(None, "lab") == FAILED
    assert "no flight on this machine" in capsys.readouterr().err
    assert stop_everything(None, "lab", folder / "watcher-screen") == FAILED
    assert stop_everything(None, "lab", folder / "vehicle-sat2") == FAILED
    assert told.nothing()
    assert stop_everything(None, "lab", folder / "operator-anna") == OK
    assert told.commands.stop_reason == "stopped by the operator"
    told.commands.stop_reason = None
    monkeypatch.setattr(stopping, "own_keys", lambda: folder / "operator-anna")
    assert stop_everything(None, "lab") == OK  # the same without a word
    assert told.commands.stop_reason == "stopped by the operator"
    assert "  sat1: stops\n" in capsys.readouterr().out


def test_stop_on_the_hosts_machine_needs_no_keys(rig, folder, endpoint, nowhere):
    told = Commanded(rig["vehicle-sat1"], "sat1")
    wait_for(lambda: _answers(rig.host, KEYS.of("sat1", "order")))
    with noted(endpoint, "lab", str(folder / "host")):
        assert stop_everything(None, "lab") == OK
    assert told.commands.stop_reason == "stopped by the operator"


def test_stop_without_the_keys_it_needs_says_what_still_works(nowhere, endpoint, capsys):
    assert stop_everything(endpoint, "lab") == FAILED
    assert "main valve" in capsys.readouterr().err


def test_bad_keys_at_home_do_not_keep_the_flights_here_from_being_stopped(
    rig, folder, endpoint, nowhere, capsys
):
    told = Commanded(rig["vehicle-sat1"], "sat1")
    wait_for(lambda: _answers(rig.host, KEYS.of("sat1", "order")))
    (nowhere / "home").mkdir()
    with noted(endpoint, "lab", str(folder / "host")):
        assert stop_everything(None, "lab") == FAILED
    assert told.commands.stop_reason == "stopped by the operator"
    assert "no keys in" in capsys.readouterr().err


@pytest.mark.parametrize("note", ["5", "[]", '["a", "b", "c", "d"]', "\x00", "{", '{"a": 1}'])
def test_a_note_that_says_nothing_does_not_stop_the_stop(nowhere, note):
    import os

    with noted("tcp/127.0.0.1:1", "lab"):
        pass
    place = flight_note._folders()[0][0] / f"{os.getpid()}.json"
    place.write_text(note)
    assert stop_everything(None, "lab") == FAILED


def test_the_list_is_toml_that_a_person_can_edit(folder):
    text = (folder / "host" / ACCESS).read_text()
    assert text.startswith("# Parties that may use")
    assert [p["role"] for p in tomllib.loads(text)["party"]] == [
        "host", "table", "vehicle", "vehicle", "operator", "watcher",
    ]  # fmt: skip
    assert Path(folder / "host" / ACCESS).exists()


def test_a_vehicle_sees_whether_another_has_its_name_and_nothing_more(rig, folder, endpoint):
    own, other = KEYS.of("sat1", "alive"), KEYS.of("sat2", "alive")
    tokens = [
        rig[who].liveliness().declare_token(key)
        for who, key in (("vehicle-sat1", own), ("vehicle-sat2", other))
    ]
    for key in (own, other):
        wait_for(lambda key=key: list(rig.host.liveliness().get(key)))
    with dial(endpoint, 1.0, folder / "vehicle-sat1") as second:
        wait_for(lambda: list(second.liveliness().get(own, timeout=1.0)))
        assert not list(second.liveliness().get(other, timeout=0.5))
    del tokens
