"""Who is let in, and what a press does."""

import http.client
import json
import socket
from threading import Thread

import pytest

from testbed.console.hub import Hub
from testbed.console.server import PAGES, Answers, ConsoleError, Server

TOKEN = "a-token"


@pytest.fixture
def serve():
    servers = []

    def start(token="", bind="127.0.0.1"):
        pressed = []

        def press(name):
            pressed.append(name)
            return {"lines": ["sat1: stops"], "sent": True}

        def request(data):
            pressed.append(data)
            return {"ok": True, "words": "", "now": "1"}

        server = Server(bind, 0, token, Answers(Hub(), lambda: b"null", press, request))
        Thread(target=server.serve_forever, daemon=True).start()
        servers.append(server)
        return server, pressed

    yield start
    for server in servers:
        server.shutdown()
        server.server_close()


def ask(server, method, path, body=None, **headers):
    link = http.client.HTTPConnection("127.0.0.1", server.server_port, timeout=10)
    link.request(method, path, body, {name.replace("_", "-"): v for name, v in headers.items()})
    answer = link.getresponse()
    said = answer.status, dict(answer.getheaders()), answer.read()
    link.close()
    return said


def test_on_loopback_the_page_needs_no_token(serve):
    server, _ = serve()
    for path in PAGES:
        status, headers, data = ask(server, "GET", path)
        assert (status, headers["Cache-Control"]) == (200, "no-store")
        assert data
    assert json.loads(ask(server, "GET", "/picture?after=")[2])["age"] is None
    assert ask(server, "GET", "/etc/passwd")[0] == 404


def test_a_page_of_another_name_is_refused(serve):
    server, pressed = serve()
    assert ask(server, "GET", "/picture", Host="evil.example")[0] == 403
    assert ask(server, "POST", "/stop", "1", Host="evil.example", X_Console="stop")[0] == 403
    assert pressed == []


def test_a_press_needs_the_header_of_our_page(serve):
    server, pressed = serve()
    assert ask(server, "POST", "/stop", "1")[0] == 403
    status, _, data = ask(server, "POST", "/stop", "1", X_Console="stop")
    assert (status, json.loads(data)["lines"]) == (200, ["sat1: stops"])
    assert pressed == ["1"]


def test_off_loopback_nothing_is_told_without_the_token(serve):
    with pytest.raises(ConsoleError):
        serve(bind="0.0.0.0")
    server, pressed = serve(TOKEN)
    for method, path in (("GET", "/"), ("GET", "/picture"), ("GET", "/scene"), ("POST", "/stop")):
        body = "1" if method == "POST" else None
        assert ask(server, method, path, body, X_Console="stop")[0] == 403
        assert ask(server, method, path, body, X_Console="stop", Cookie="console=wrong")[0] == 403
    assert ask(server, "GET", "/?token=wrong")[0] == 403
    assert pressed == []
    status, headers, _ = ask(server, "GET", f"/?token={TOKEN}")
    assert (status, headers["Location"]) == (303, "/")
    assert "HttpOnly; SameSite=Strict" in headers["Set-Cookie"]
    cookie = headers["Set-Cookie"].partition(";")[0]
    assert ask(server, "POST", "/stop", "1", X_Console="stop", Cookie=cookie)[0] == 200
    assert pressed == ["1"]


@pytest.mark.parametrize("length", ["99999", "-1", "x"])
def test_a_large_or_wrong_body_is_refused(serve, length):
    server, pressed = serve()
    with socket.create_connection(("127.0.0.1", server.server_port), timeout=10) as line:
        line.sendall(
            f"POST /stop HTTP/1.1\r\nHost: localhost\r\nContent-Length: {length}\r\n"
            "X-Console: stop\r\n\r\n".encode()
        )
        assert b" 413 " in line.recv(4096)
    assert pressed == []


def test_a_reader_that_does_not_read_keeps_no_one_waiting(serve):
    server, pressed = serve()
    with socket.create_connection(("127.0.0.1", server.server_port), timeout=10) as line:
        line.sendall(b"GET /picture?after= HTTP/1.1\r\nHost: localhost\r\n\r\n" * 500)
        assert ask(server, "POST", "/stop", "1", X_Console="stop")[0] == 200
    assert pressed == ["1"]


def test_a_taken_port_is_said(serve):
    server, _ = serve()
    with pytest.raises(ConsoleError, match=f"cannot serve at 127.0.0.1:{server.server_port}"):
        Server("127.0.0.1", server.server_port, "", server.answers)
