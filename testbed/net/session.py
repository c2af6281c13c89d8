"""Opening Zenoh sessions, and the small API of this project on top of them.

The host listens at the lab file's endpoint and routes messages between vehicles; all other parties
connect to it. Scouting is off, and only the host listens: Zenoh's default is to listen on every
interface. Messages are dropped when the network is full; no sender waits for it.

Without keys only loopback endpoints are opened. With keys both ends show a certificate of the lab's
authority, and the host enforces the rights in `access.py`.
"""

import json
from collections import deque
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import zenoh

from testbed.core.error import TestbedError
from testbed.net.credentials import CredentialsError, read_credentials, tls, untrusted
from testbed.realtime.wall_clock import monotonic_ns

LARGEST = 1 << 18  # largest message [bytes]; an experiment has 20 kB
LEASE_MS = 400  # a peer that is silent for this long is lost
BURST = 16  # messages queued at once; Zenoh's default of 2 loses a third of a burst
OPEN_S = 10.0  # time for the other side's handshake; Zenoh's default
PENDING = 64  # messages kept per key between two reads; older ones are dropped


class NetworkError(TestbedError):
    """A session cannot be opened, or a query was not answered."""


class NoHostError(NetworkError):
    """No host listens at the endpoint, or one side rejects the other's certificate."""


def _config(
    mode: str, listen: list[str], connect: list[str], wait_ms: int,
    keys: Path | None = None, control: Mapping[str, Any] | None = None, open_s: float = OPEN_S,
) -> zenoh.Config:  # fmt: skip
    return zenoh.Config.from_json5(
        json.dumps({
            "mode": mode,
            "access_control": control or {"enabled": False},
            "scouting": {
                "multicast": {"enabled": False},
                "gossip": {"enabled": False},
                "delay": 0,
            },
            "listen": {"endpoints": listen},
            "connect": {
                "endpoints": connect,
                "timeout_ms": wait_ms,
                "exit_on_failure": True,
                "retry": {
                    "period_init_ms": 50, "period_max_ms": 200, "period_increase_factor": 1.5,
                },
            },
            "transport": {
                "unicast": {"open_timeout": round(1e3 * open_s)},
                "link": {
                    "tls": tls(keys) if keys is not None else {},
                    "rx": {"max_message_size": LARGEST},
                    "tx": {
                        "lease": LEASE_MS,
                        "keep_alive": 4,
                        "queue": {
                            "congestion_control": {"drop": {"wait_before_drop": 0}},
                            "size": {"real_time": BURST},
                        },
                    },
                },
                "shared_memory": {"enabled": False},
            },
        })
    )  # fmt: skip


def _words(error: zenoh.ZError) -> str:
    """Zenoh's error message without its source location."""
    return str(error).partition(" at /")[0].rstrip(" .!")


def _checked(endpoint: str, keys: Path | None) -> None:
    """Raise a NetworkError if the endpoint must not be opened with these keys."""
    if (why := untrusted(endpoint, keys)) is not None:
        raise NetworkError(f"{endpoint} is not opened: {why}")
    if keys is not None:
        try:
            read_credentials(keys)
        except CredentialsError as error:
            raise NetworkError(str(error)) from None


def listen(
    endpoint: str, keys: Path | None = None, control: Mapping[str, Any] | None = None
) -> zenoh.Session:
    """Open the host's session.

    Args:
        endpoint: in Zenoh's notation.
        keys: the host's key folder; None: no keys, only this machine can connect.
        control: access rules, see `access.control`.

    Raises:
        NetworkError: the endpoint is taken or invalid, or the keys are invalid.
    """
    _checked(endpoint, keys)
    try:
        return zenoh.open(_config("router", [endpoint], [], 0, keys, control))
    except zenoh.ZError as error:
        raise NetworkError(
            f"cannot listen on {endpoint}: {_words(error)}; expected a free address of this"
            " machine, see [lab.network] of the table file"
        ) from None


def dial(
    endpoint: str, wait_s: float = 1.0, keys: Path | None = None, open_s: float = OPEN_S
) -> zenoh.Session:
    """Open the session of a vehicle or another party.

    Args:
        endpoint: in Zenoh's notation.
        wait_s: time for a host to listen there.
        keys: this party's key folder; None: no keys.
        open_s: time for the host's handshake.

    Raises:
        NoHostError: no host listens there, or one side rejects the other's certificate.
        NetworkError: the endpoint must not be opened with these keys.
    """
    _checked(endpoint, keys)
    try:
        return zenoh.open(
            _config("client", [], [endpoint], round(1e3 * wait_s), keys, open_s=open_s)
        )
    except zenoh.ZError as error:
        doubt = "" if keys is None else f", and are the keys in {keys} of its lab and not expired"
        raise NoHostError(
            f"no host answers at {endpoint}: {_words(error)}; is `testbed run` waiting on the host,"
            f" and is the address right{doubt}?"
        ) from None


class Subscriber:
    """Messages received on a key, with the time of arrival; newest last."""

    def __init__(
        self, session: zenoh.Session, key: str, arrival: Callable[[int], int | None] | None = None
    ) -> None:
        self._waiting: deque[tuple[int, bytes]] = deque(maxlen=PENDING)
        self._arrival = arrival
        self.arrived = 0  # messages so far, also those that were dropped
        self._subscriber = session.declare_subscriber(
            key,
            zenoh.handlers.Callback(self._receive, indirect=False),  # short, never blocks
            allowed_origin=zenoh.Locality.REMOTE,
        )

    def _receive(self, sample: Any) -> None:
        at: int | None = monotonic_ns()
        self.arrived += 1
        if self._arrival is not None:
            assert at is not None
            at = self._arrival(at)
        if at is not None:
            self._waiting.append((at, sample.payload.to_bytes()))

    def close(self) -> None:
        """Undeclare the subscription: no message arrives after this."""
        self._subscriber.undeclare()

    def received(self) -> list[tuple[int, bytes]]:
        """Messages since the last call, in order of arrival; their times are monotonic [ns]."""
        now = monotonic_ns()
        messages = [self._waiting.popleft() for _ in range(len(self._waiting))]
        late = [message for message in messages if message[0] > now]
        self._waiting.extendleft(reversed(late))
        return sorted((m for m in messages if m[0] <= now), key=lambda m: m[0])


def on_message(session: zenoh.Session, key: str, do: Callable[[bytes], object]) -> Any:
    """Call `do` with the message, in Zenoh's thread, whenever one arrives on a key."""

    def receive(sample: Any) -> None:
        do(sample.payload.to_bytes())

    return session.declare_subscriber(key, zenoh.handlers.Callback(receive, indirect=False))


class Publisher:
    """Sends messages on a key. Keep the object: Zenoh closes a publisher without a reference."""

    def __init__(self, session: zenoh.Session, key: str, *, bulk: bool = False) -> None:
        self._publisher = session.declare_publisher(
            key,
            congestion_control=zenoh.CongestionControl.DROP,
            priority=zenoh.Priority.DATA if bulk else zenoh.Priority.REAL_TIME,
            express=not bulk,
        )

    def send(self, data: bytes) -> None:
        """Publish a message without waiting for the network."""
        self._publisher.put(data)


def answer_to(
    session: zenoh.Session, key: str, answer: Callable[[bytes], bytes]
) -> zenoh.Queryable[None]:
    """Answer queries on a key; keep the result. An exception is sent to the sender as an error."""

    def on(query: Any) -> None:
        with query:
            asked = query.payload.to_bytes() if query.payload is not None else b""
            try:
                query.reply(query.key_expr, answer(asked))
            except Exception as error:  # any error: silence would look like no queryable
                query.reply_err(f"{type(error).__name__}: {error}".encode())

    return session.declare_queryable(
        key, zenoh.handlers.Callback(on, indirect=False), complete=True
    )


def answers(session: zenoh.Session, key: str, wait_s: float, question: bytes = b"") -> list[bytes]:
    """Answers of all parties to a query."""
    replies = session.get(
        key,
        payload=question,
        timeout=wait_s,
        target=zenoh.QueryTarget.ALL,
        consolidation=zenoh.ConsolidationMode.NONE,
    )
    return [reply.ok.payload.to_bytes() for reply in replies if reply.ok is not None]


def ask(session: zenoh.Session, key: str, question: bytes = b"", wait_s: float = 1.0) -> bytes:
    """The answer to a query.

    Raises:
        NetworkError: no answer came in time, or the answer is an error.
    """
    reason = "no party is there"
    for reply in session.get(key, payload=question, timeout=wait_s):
        if reply.ok is not None:
            return bytes(reply.ok.payload.to_bytes())
        assert reply.err is not None
        reason = reply.err.payload.to_bytes().decode(errors="replace")
    raise NetworkError(f"no answer on {key}: {reason}")
