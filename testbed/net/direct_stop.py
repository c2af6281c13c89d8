"""Stops a vehicle without its host, by datagrams between the operator and the vehicle.

Zenoh's messages pass through the host, so they are lost when the host hangs or is dead. Every
vehicle therefore also listens on a UDP port of its own:

    operator: who       vehicle: its name and a random number
    operator: stop      vehicle: stops

With keys the operator signs the vehicle's number, and the vehicle signs its answer; a recorded stop
cannot be sent again. Without keys the vehicle hears this machine only. The port follows the host's:
the first free one of the PORTS ports after it.
"""

import json
import secrets
import socket
import struct
import threading
from collections.abc import Callable, Collection, Iterator
from contextlib import suppress
from pathlib import Path
from time import monotonic
from typing import TYPE_CHECKING, Any

from testbed.net.credentials import is_local

if TYPE_CHECKING:
    from testbed.net.signature import Signer

PORTS = 16  # vehicles on one machine that can be stopped without the host
GROUP = "239.255.74.50"  # multicast group of the vehicles (administratively scoped, RFC 2365)
LARGEST = 4096  # datagram [bytes]
AGAIN_S = 0.03  # between two questions
IGNORED_S = 0.1  # after a bad signature its sender is not heard for this long
LOCAL, ANY = "127.0.0.1", ""  # addresses that a vehicle binds


def ports(endpoint: str) -> range:
    """Ports of the vehicles of a host; empty if the endpoint has no port."""
    text = endpoint.partition("?")[0].partition("#")[0].rpartition(":")[2]
    if not text.isdecimal():
        return range(0)
    port = int(text)
    return range(port + 1, min(port + 1 + PORTS, 65536))


def _address_towards(endpoint: str) -> str:
    """This machine's address in the host's network."""
    host, _, port = endpoint.partition("/")[2].partition("?")[0].rpartition(":")
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.connect((host, int(port)))  # nothing is sent
        return str(probe.getsockname()[0])


def _signer(keys: Path | None) -> "Signer | None":
    if keys is None:
        return None
    from testbed.net.signature import Signer  # slow import, and `testbed stop` must start fast

    return Signer(keys)


def _decode(data: bytes, lab: str) -> dict[str, Any]:
    """A message of this lab; empty: not a message of this lab."""
    with suppress(ValueError, RecursionError):
        message = json.loads(data)
        if isinstance(message, dict) and message.get("lab") == lab:
            return message
    return {}


def _demand(lab: str, vehicle: str, nonce: str, stop: str) -> bytes:
    """Text that the operator signs."""
    return "\n".join(("testbed stop", lab, vehicle, nonce, stop)).encode()


def _receipt(lab: str, vehicle: str, nonce: str) -> bytes:
    """Text that the vehicle signs."""
    return "\n".join(("testbed stopped", lab, vehicle, nonce)).encode()


class StopListener:
    """A vehicle's own port for stops; close it with the flight."""

    def __init__(
        self, name: str, lab: str, endpoint: str, keys: Path | None, stop: Callable[[str], object]
    ) -> None:
        """Start to listen.

        Args:
            name: of the vehicle.
            lab: first part of the network keys.
            endpoint: of the host.
            keys: the vehicle's key folder; None: only this machine is heard.
            stop: called in another thread with the id of each stop.

        Raises:
            OSError: no port is free, or the keys cannot be read.
        """
        self._name, self._lab, self._stop = name, lab, stop
        self._signer = _signer(keys)
        self._nonce, self._obeyed = secrets.token_hex(16), ""
        self._ignored: dict[Any, float] = {}  # senders of bad signatures, and until when [s]
        self._closed = False
        self._socket = self._bind(endpoint)
        self.port: int = self._socket.getsockname()[1]
        self._thread = threading.Thread(target=self._listen, name="direct stop", daemon=True)
        self._thread.start()

    def _bind(self, endpoint: str) -> socket.socket:
        local = self._signer is None or is_local(endpoint)
        trouble: OSError = OSError(f"no port after that of {endpoint}")
        for port in ports(endpoint):
            one = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
            try:
                one.bind((LOCAL if local else ANY, port))
                if not local:
                    own = socket.inet_aton(_address_towards(endpoint))
                    membership = struct.pack("4s4s", socket.inet_aton(GROUP), own)
                    one.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, membership)
            except OSError as error:
                one.close()
                trouble = error
            else:
                return one
        raise trouble

    def close(self) -> None:
        """Close the socket and end the thread."""
        self._closed = True
        with suppress(OSError):
            self._socket.sendto(b"", (LOCAL, self.port))  # wakes the thread
        self._thread.join(1.0)
        self._socket.close()

    def _listen(self) -> None:
        while not self._closed:
            with suppress(OSError):  # such as an unreachable sender of the last datagram
                data, sender = self._socket.recvfrom(LARGEST)
                if (answer := self._answer(data, sender)) is not None:
                    self._socket.sendto(json.dumps(answer).encode(), sender)

    def _answer(self, data: bytes, sender: tuple[str, int]) -> dict[str, str] | None:
        message = _decode(data, self._lab)
        own = {"lab": self._lab, "vehicle": self._name}
        if message.get("ask") == "who":
            return {**own, "nonce": self._nonce}
        if message.get("ask") != "stop" or message.get("vehicle") != self._name:
            return None
        nonce, stop = message.get("nonce"), message.get("id")
        if nonce not in (self._nonce, self._obeyed) or not isinstance(stop, str):
            return None
        if not self._may(message, _demand(self._lab, self._name, nonce, stop), sender):
            return None
        if nonce == self._nonce:  # otherwise the answer to an obeyed stop was lost
            self._obeyed, self._nonce = nonce, secrets.token_hex(16)
            self._stop(stop)
        receipt = _receipt(self._lab, self._name, nonce)
        return {**own, "stops": nonce, **(self._signer.sign(receipt) if self._signer else {})}

    def _may(self, message: dict[str, str], demand: bytes, sender: tuple[str, int]) -> bool:
        """Whether the sender may stop this vehicle: the host and operators may."""
        if self._signer is None:
            return True
        if monotonic() < self._ignored.get(sender[0], 0.0):
            return False
        signer = self._signer.signed_by(demand, message) or ""
        if signer == "host" or signer.startswith("operator-"):
            return True
        self._ignored = {sender[0]: monotonic() + IGNORED_S}
        return False


def stop_directly(
    endpoint: str, lab: str, keys: Path | None, vehicles: Collection[str], stop: str,
    wait_s: float,
) -> set[str]:  # fmt: skip
    """Stop the vehicles of a host without it.

    Args:
        endpoint: of the host.
        lab: first part of the network keys.
        keys: key folder of an operator or of the host; None: vehicles without keys.
        vehicles: names that are expected; empty: not known.
        stop: id of this stop; copies of one stop have the same.
        wait_s: longest wait for answers [s].

    Returns:
        Names of the vehicles that have stopped.
    """
    try:
        signer = _signer(keys)
    except (ImportError, OSError, ValueError):  # Zenoh says what is wrong with the keys
        return set()
    stopped: set[str] = set()
    question = json.dumps({"lab": lab, "ask": "who"}).encode()
    end = monotonic() + wait_s
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as line:
        places = _places(line, endpoint, signed=signer is not None)
        while monotonic() < end and not (vehicles and stopped >= set(vehicles)):
            for place in places:
                with suppress(OSError):
                    line.sendto(question, place)
            for message, place in _messages(line, lab, min(monotonic() + AGAIN_S, end)):
                name, nonce = message.get("vehicle"), message.get("nonce")
                if not isinstance(name, str) or name in stopped:
                    continue
                if isinstance(nonce, str):
                    with suppress(OSError):
                        line.sendto(_order(signer, lab, name, nonce, stop), place)
                elif _confirmed(signer, lab, name, message):
                    stopped.add(name)
                    if vehicles and stopped >= set(vehicles):
                        break
    return stopped


def _places(line: socket.socket, endpoint: str, *, signed: bool) -> list[tuple[str, int]]:
    """Where vehicles of a host may listen; those of other machines accept signed stops only."""
    places = [(LOCAL, port) for port in ports(endpoint)]
    if signed and not is_local(endpoint):
        with suppress(OSError):
            own = socket.inet_aton(_address_towards(endpoint))
            line.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, own)
            places += [(GROUP, port) for port in ports(endpoint)]
    return places


def _messages(
    line: socket.socket, lab: str, until: float
) -> Iterator[tuple[dict[str, Any], tuple[str, int]]]:
    """Messages of the lab's vehicles that arrive until a monotonic time [s], and their senders."""
    while (left := until - monotonic()) > 0.0:
        line.settimeout(left)
        try:
            data, sender = line.recvfrom(LARGEST)
        except OSError:  # also if no vehicle listens at one of the ports
            continue
        yield _decode(data, lab), sender


def _order(signer: "Signer | None", lab: str, name: str, nonce: str, stop: str) -> bytes:
    """The order to stop."""
    order = {"lab": lab, "ask": "stop", "vehicle": name, "nonce": nonce, "id": stop}
    if signer is not None:
        order |= signer.sign(_demand(lab, name, nonce, stop))
    return json.dumps(order).encode()


def _confirmed(signer: "Signer | None", lab: str, name: str, message: dict[str, str]) -> bool:
    """Whether an answer is the vehicle's receipt."""
    nonce = message.get("stops")
    if not isinstance(nonce, str):
        return False
    if signer is None:
        return True
    return signer.signed_by(_receipt(lab, name, nonce), message) == f"vehicle-{name}"
