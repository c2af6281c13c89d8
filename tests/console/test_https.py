"""The page by HTTPS with the lab's keys, and by plain HTTP without."""

import http.client
import shutil
import socket
import ssl
from threading import Thread

import pytest
import tomli_w

from testbed.config import dump, find, load
from testbed.console.encryption import lab_certificate
from testbed.console.hub import Hub
from testbed.console.process import address, open_server
from testbed.console.server import Answers, ConsoleError

TOKEN = "a-token"
ANSWERS = Answers(
    Hub(), lambda: b"null", lambda name: {"lines": [], "sent": True}, lambda data: {"ok": False}
)

certificates = pytest.importorskip("testbed.net.certificate_authority")


@pytest.fixture(scope="module")
def keys(tmp_path_factory):
    folder = tmp_path_factory.mktemp("lab") / "keys"
    wanted = certificates.Wanted("lab", "tls/127.0.0.1:7450", ["127.0.0.1"], [("host", "host")], 30)
    certificates.make_keys(folder, wanted, force=False)
    return folder


def run_with(folder, keys):
    """A run folder whose table file names these keys."""
    folder.mkdir()
    lab = f'keys="{keys}",endpoint="tls/127.0.0.1:7450"' if keys else ""
    tree = dump(load(find("hold"), [f"table.lab.network={{{lab}}}"] if keys else []))
    (folder / "config.toml").write_text(tomli_w.dumps(tree))
    return folder


@pytest.fixture
def server(keys, tmp_path):
    encryption = lab_certificate(run_with(tmp_path / "run", keys / "host"))
    one = open_server("127.0.0.1", 0, TOKEN, ANSWERS, encryption)
    Thread(target=one.serve_forever, daemon=True).start()
    yield one
    one.shutdown()
    one.server_close()


def trusting(keys):
    return ssl.create_default_context(cafile=keys / "host" / "authority.pem")


def test_a_browser_that_trusts_the_lab_reads_the_page(server, keys):
    link = http.client.HTTPSConnection("127.0.0.1", server.server_port, timeout=20,
                                       context=trusting(keys))  # fmt: skip
    link.request("GET", f"/?token={TOKEN}")
    answer = link.getresponse()
    answer.read()
    assert answer.status == 303
    assert answer.getheader("Set-Cookie").endswith("; Secure")
    link.request("GET", "/scene")
    answer = link.getresponse()
    answer.read()
    assert answer.status == 403  # encryption alone lets no one in
    link.close()
    assert address("127.0.0.1", 1, TOKEN, "https") == "https://127.0.0.1:1/?token=a-token"


def test_a_stranger_does_not_trust_it_and_plain_http_gets_nothing(server):
    stranger = http.client.HTTPSConnection("127.0.0.1", server.server_port, timeout=20)
    with pytest.raises(ssl.SSLCertVerificationError):
        stranger.request("GET", "/")
    plain = http.client.HTTPConnection("127.0.0.1", server.server_port, timeout=20)
    plain.request("GET", "/")
    with pytest.raises((http.client.HTTPException, OSError)):
        plain.getresponse()
    stranger.close()
    plain.close()


def test_a_connection_that_never_shakes_hands_keeps_no_one_waiting(server, keys):
    with socket.create_connection(("127.0.0.1", server.server_port), timeout=20):
        link = http.client.HTTPSConnection("127.0.0.1", server.server_port, timeout=20,
                                           context=trusting(keys))  # fmt: skip
        link.request("GET", f"/?token={TOKEN}")
        assert link.getresponse().status == 303
        link.close()


def test_without_keys_there_is_no_certificate(tmp_path):
    assert lab_certificate(run_with(tmp_path / "run", None)) is None
    assert lab_certificate(tmp_path / "nothing") is None


def test_keys_that_cannot_be_read_are_said(keys, tmp_path):
    broken = tmp_path / "broken"
    shutil.copytree(keys / "host", broken)
    (broken / "private.key").write_text("nothing")
    run = run_with(tmp_path / "run", broken)
    with pytest.raises(ConsoleError, match=str(broken)):
        lab_certificate(run)
