"""A vehicle's second line for stops: to the operator's page, past the host.

The page tells its port on `operator/line`; it is on the host's machine. A thread of its own connects
there, because a connection may take seconds. Only stops are heard on it.
"""

import threading
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import Any

import zenoh

from testbed.net.keys import Keys
from testbed.net.session import NetworkError, answer_to, dial, on_word

TRY_S = 1.0
AGAIN_S = 1.0  # between two looks at the connection


class SecondLine:
    """Connects when it is told a port.

    Args:
        session: to the host.
        keys: of the lab.
        name: of the vehicle.
        endpoint: of the host.
        badge: the vehicle's key folder.
        stopped: called at a stop; returns the answer.
    """

    def __init__(
        self, session: zenoh.Session, keys: Keys, name: str, endpoint: str, badge: Path | None,
        stopped: Callable[[], bytes],
    ) -> None:  # fmt: skip
        self._keys, self._name, self._badge, self._stopped = keys, name, badge, stopped
        self._front = endpoint.rpartition(":")[0]
        self._told: SimpleQueue[int] = SimpleQueue()
        self._left = threading.Event()
        self._line: zenoh.Session | None = None
        self._kept: list[Any] = []
        self._port = 0  # of the line
        self._ear = session.declare_subscriber(
            keys.line, zenoh.handlers.Callback(self._hear, indirect=False)
        )
        self._thread = threading.Thread(target=self._run, name="second line", daemon=True)
        self._thread.start()

    def _hear(self, sample: Any) -> None:
        word = sample.payload.to_bytes()[:6]
        if word.isdigit() and 0 < int(word) < 65536:
            self._told.put(int(word))

    def _run(self) -> None:
        while not self._left.is_set():
            with suppress(Empty):
                port = self._told.get(timeout=AGAIN_S)
                if port != self._port and not self._left.is_set():
                    self._connect(port)

    def _connect(self, port: int) -> None:
        self._hang_up()
        try:
            line = dial(f"{self._front}:{port}", TRY_S, self._badge)
        except NetworkError:
            return  # it is told again
        self._kept = [
            answer_to(line, self._keys.stop, lambda _: self._stopped()),
            on_word(line, self._keys.stop, self._stopped),
            line.liveliness().declare_token(self._keys.of(self._name, "alive")),
        ]
        self._line, self._port = line, port

    def _hang_up(self) -> None:
        line, self._line, self._kept, self._port = self._line, None, [], 0
        if line is not None:
            with suppress(zenoh.ZError):
                line.close()

    def close(self) -> None:
        """Disconnect; a connection that is being made is left to the process's end."""
        self._left.set()
        self._ear.undeclare()
        self._told.put(0)
        self._thread.join(TRY_S)
        if not self._thread.is_alive():
            self._hang_up()
