"""Serves the operator's page: files, the newest picture, and the button.

    GET  /                  the page; `?token=...` signs a browser in
    GET  /picture?after=N   the newest picture, as soon as there is one after version N
    GET  /scene             what does not move
    POST /stop              stop the flight; the body names the press
    POST /request           change the flight, see `controls.py`

A reader asks again after each answer, so a slow one skips pictures. Off loopback every request
needs the token. The header `X-Console` keeps pages of other sites from pressing the button.
"""

import hmac
import ipaddress
import json
from collections.abc import Callable
from http import HTTPStatus
from http.cookies import CookieError, SimpleCookie
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib.resources import files
from ssl import SSLContext
from threading import BoundedSemaphore
from typing import Any, NamedTuple
from urllib.parse import parse_qs, urlsplit

from testbed.console.hub import Hub
from testbed.core.error import TestbedError

WAIT_S = 0.5  # longest wait for a new picture
READERS = 32  # waiting at once
LARGEST = 4096  # body of a request [bytes]
COOKIE = "console"
PAGES = {
    "/": ("index.html", "text/html; charset=utf-8"),
    "/console.css": ("console.css", "text/css; charset=utf-8"),
    "/console.js": ("console.js", "text/javascript; charset=utf-8"),
    "/draw.js": ("draw.js", "text/javascript; charset=utf-8"),
    "/controls.js": ("controls.js", "text/javascript; charset=utf-8"),
    "/controls.css": ("controls.css", "text/css; charset=utf-8"),
}
HEADERS = {
    "Cache-Control": "no-store",
    "Content-Security-Policy": "default-src 'self'; style-src 'self' 'unsafe-inline';"
    " frame-ancestors 'none'",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
}


class ConsoleError(TestbedError):
    """The page cannot be served."""


class Answers(NamedTuple):
    """Functions that the server calls: picture, scene, stop, requests."""

    hub: Hub
    scene: Callable[[], bytes]
    press: Callable[[str], dict[str, Any]]
    request: Callable[[bytes], dict[str, Any]]


class Handler(BaseHTTPRequestHandler):
    """Answers one browser's requests."""

    protocol_version = "HTTP/1.1"
    timeout = 20.0  # of a browser that neither asks nor reads [s]
    server: "Server"

    def do_GET(self) -> None:
        """Answer a request; see the module."""
        url = urlsplit(self.path)
        words = parse_qs(url.query)
        if url.path == "/" and self.server.admits(words.get("token", [""])[0]):
            self._sign_in(words["token"][0])
        elif not self._admitted():
            self._refuse()
        elif url.path in PAGES:
            name, kind = PAGES[url.path]
            self._send(HTTPStatus.OK, kind, self.server.pages[name])
        elif url.path == "/scene":
            self._send(HTTPStatus.OK, "application/json", self.server.answers.scene())
        elif url.path == "/picture":
            self._picture(words.get("after", ["-1"])[0])
        else:
            self._send(HTTPStatus.NOT_FOUND, "text/plain", b"not found\n")

    def do_POST(self) -> None:
        """Answer a request; see the module."""
        length = self.headers.get("Content-Length", "0")
        if not length.isdecimal() or int(length) > LARGEST:
            self.close_connection = True
            self._send(HTTPStatus.REQUEST_ENTITY_TOO_LARGE, "text/plain", b"too large\n")
            return
        body = self.rfile.read(int(length))
        if not self._admitted() or "X-Console" not in self.headers:
            self._refuse()
        elif self.path == "/stop":
            self._send_answer(self.server.answers.press(body.decode(errors="replace")[:64]))
        elif self.path == "/request":
            self._send_answer(self.server.answers.request(body))
        else:
            self._send(HTTPStatus.NOT_FOUND, "text/plain", b"not found\n")

    def _send_answer(self, answer: dict[str, Any]) -> None:
        self._send(HTTPStatus.OK, "application/json", json.dumps(answer).encode())

    def _picture(self, after: str) -> None:
        if not self.server.readers.acquire(blocking=False):
            self._send(HTTPStatus.SERVICE_UNAVAILABLE, "text/plain", b"too many readers\n")
            return
        try:
            version = int(after) if after.isdecimal() and len(after) < 16 else -1
            data = self.server.answers.hub.newest(version, WAIT_S)
        finally:
            self.server.readers.release()
        self._send(HTTPStatus.OK, "application/json", data)

    def _admitted(self) -> bool:
        """Whether this request may be answered."""
        if not self.server.token:  # on loopback; another name would be a page's trick with DNS
            host = urlsplit(f"//{self.headers.get('Host', '')}").hostname or ""
            return host == "localhost" or is_loopback(host)
        cookies = SimpleCookie()
        try:
            cookies.load(self.headers.get("Cookie", ""))
        except CookieError:
            return False
        return COOKIE in cookies and self.server.admits(cookies[COOKIE].value)

    def _sign_in(self, token: str) -> None:
        self.send_response(HTTPStatus.SEE_OTHER)
        self.send_header("Location", "/")
        rules = "HttpOnly; SameSite=Strict; Path=/" + "; Secure" * self.server.encrypted
        self.send_header("Set-Cookie", f"{COOKIE}={token}; {rules}")
        self.send_header("Content-Length", "0")
        self.end_headers()

    def _refuse(self) -> None:
        self.close_connection = True
        words = b"not signed in: open the address that `testbed` has printed, with its token\n"
        self._send(HTTPStatus.FORBIDDEN, "text/plain; charset=utf-8", words)

    def _send(self, status: HTTPStatus, kind: str, data: bytes) -> None:
        self.send_response(status)
        self.send_header("Content-Type", kind)
        self.send_header("Content-Length", str(len(data)))
        for name, value in HEADERS.items():
            self.send_header(name, value)
        self.end_headers()
        self.wfile.write(data)

    def log_message(self, format: str, *args: Any) -> None:
        """Requests are not logged."""


class Server(ThreadingHTTPServer):
    """The server; one thread per connection.

    Args:
        bind: address to listen at.
        port: 0: any free one.
        token: that a browser must show; empty: none, on loopback only.
        answers: where its answers come from.
        encryption: for HTTPS; None: plain HTTP.

    Raises:
        ConsoleError: the address cannot be used.
    """

    daemon_threads = True
    request_queue_size = 64

    def __init__(
        self, bind: str, port: int, token: str, answers: Answers,
        encryption: SSLContext | None = None,
    ) -> None:  # fmt: skip
        if not token and not is_loopback(bind):
            raise ConsoleError(f"{bind} is not this machine alone: expected a token")
        self.answers, self.token = answers, token
        self.readers = BoundedSemaphore(READERS)
        folder = files("testbed.console") / "page"
        self.pages = {name: (folder / name).read_bytes() for name, _ in PAGES.values()}
        try:
            super().__init__((bind, port), Handler)
        except OSError as error:
            raise ConsoleError(f"cannot serve at {bind}:{port}: {error.strerror}") from None
        self.encrypted = encryption is not None
        if encryption is not None:  # a handshake waits in the thread of its connection
            self.socket = encryption.wrap_socket(
                self.socket, server_side=True, do_handshake_on_connect=False
            )

    def admits(self, token: str) -> bool:
        """Whether this is the token."""
        return bool(self.token) and hmac.compare_digest(token.encode(), self.token.encode())

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Ignore it: browsers may disconnect at any time."""


def is_loopback(host: str) -> bool:
    """Whether an address reaches this machine only."""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"
