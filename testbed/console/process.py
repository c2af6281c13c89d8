"""The page's own process: it follows a run, serves the page, and can stop the flight.

    python -m testbed.console.process RUN BIND PORT [PARENT]

`testbed run --console` starts it before the flight. It shares nothing with the process that flies:
a law that hangs, or a host that is suspended, stops neither the page nor its button. It ends
LINGER_S after its PARENT, so that the button is still there for vehicles whose host was killed.
Where the system allows it, the page is served before ordinary work, so that a press does not wait
on a busy machine, and behind hosts and vehicles.
"""

import os
import secrets
import signal
import sys
from contextlib import suppress
from pathlib import Path
from ssl import SSLContext
from threading import Event, Thread
from types import FrameType

from testbed.console.controls import RequestForwarder
from testbed.console.encryption import lab_certificate
from testbed.console.follower import Follower
from testbed.console.hub import Hub
from testbed.console.server import Answers, ConsoleError, Server, is_loopback
from testbed.console.stopper import StopSender
from testbed.core.error import TestbedError
from testbed.realtime.scheduling import realtime_priority

PORT = 8765  # preferred
LINGER_S = 20.0
LOOK_S = 0.5
LAST_S = 2.0  # for readers to get the end of the flight
BAD_INPUT = 2
PRIORITY = 1  # real-time priority, below those of flights


def serve(run: Path, bind: str, port: int | None, parent: int = 0) -> None:
    """Serve until Ctrl-C, SIGTERM, a closed terminal, or the parent's end.

    Raises:
        ConsoleError: the address cannot be used.
    """
    left = Event()

    def leave(number: int, frame: FrameType | None) -> None:
        left.set()

    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        if signal.getsignal(number) is not signal.SIG_IGN:  # as under nohup
            signal.signal(number, leave)
    sys.setswitchinterval(0.0005)  # a press does not wait for a picture
    hub, stopper = Hub(), StopSender(run)
    hub.set_status(server=secrets.token_hex(8))  # another one at the same port is another run
    follower = Follower(run, hub)
    token = "" if is_loopback(bind) else secrets.token_urlsafe(16)
    encryption = lab_certificate(run) if token else None
    forwarder = RequestForwarder(lambda: stopper.note)
    answers = Answers(hub, lambda: follower.scene, stopper.press, forwarder.request)
    server = open_server(bind, port, token, answers, encryption)
    Thread(target=server.serve_forever, name="server", daemon=True).start()
    Thread(target=follower.follow, args=(left,), name="follower", daemon=True).start()
    Thread(target=forwarder.keep, args=(left, hub), name="controls", daemon=True).start()
    Thread(target=stopper.keep, args=(left,), name="stopper", daemon=True).start()
    scheme = "https" if server.encrypted else "http"
    sys.stderr.write(f"console: {address(bind, server.server_port, token, scheme)}\n")
    sys.stderr.flush()
    alone = 0.0
    while not left.wait(LOOK_S):
        hub.set_status(stop={"words": stopper.ways.words, "ready": stopper.ways.ready})
        alone = alone + LOOK_S if parent and not is_there(parent) else 0.0
        if alone > LINGER_S:
            left.set()
    Event().wait(LAST_S)
    server.shutdown()
    server.server_close()


def open_server(
    bind: str, port: int | None, token: str, answers: Answers, encryption: SSLContext | None = None
) -> Server:
    """The server at the port, by default PORT or any free one."""
    if port is None:
        with suppress(ConsoleError):
            return Server(bind, PORT, token, answers, encryption)
    return Server(bind, port or 0, token, answers, encryption)


def address(bind: str, port: int, token: str, scheme: str = "http") -> str:
    """Address of the page, for a browser."""
    host = os.uname().nodename if bind in ("0.0.0.0", "::") else bind
    return f"{scheme}://{f'[{host}]' if ':' in host else host}:{port}/{token and f'?token={token}'}"


def is_there(pid: int) -> bool:
    """Whether a process runs."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def main() -> int:
    """Serve as the child of a run; returns the exit code."""
    run, bind, port, *parent = sys.argv[1:]
    try:
        with realtime_priority(PRIORITY):
            serve(Path(run), bind, int(port) or None, int(parent[0]) if parent else 0)
    except TestbedError as error:
        sys.stderr.write(f"console: {error}\n")
        return BAD_INPUT
    return 0


if __name__ == "__main__":
    code = main()
    sys.stderr.flush()
    os._exit(code)  # Zenoh's threads may still wait for a host
