"""A key folder: a party's identity on the network, its certificate and its private key.

    credentials.json  role, name, lab, endpoint of the host, expiry date
    authority.pem     certificate of the lab's authority; other authorities are not trusted
    certificate.pem   certificate of the party
    private.key       its private key; only its owner may read it

`testbed lab-keys` makes one folder per party. A copy of the folder gives all rights of that party.
This module imports only the standard library, so that `testbed stop` starts fast.
"""

import datetime
import ipaddress
import json
from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

from testbed.core.error import TestbedError

CREDENTIALS, AUTHORITY, CERTIFICATE, KEY = (
    "credentials.json", "authority.pem", "certificate.pem", "private.key",
)  # fmt: skip
ROLES = ("host", "table", "vehicle", "operator", "watcher")
PROTOCOLS = ("tcp", "tls", "quic", "udp", "ws")  # Zenoh's protocols with host and port
OPEN_MODE = 0o077  # mode bits that a private key must not have


SOON = datetime.timedelta(days=30)  # warn about keys that expire earlier


class CredentialsError(TestbedError):
    """The key folder is missing, damaged or must not be used."""


class Credentials(NamedTuple):
    """Identity of a party, as in its `credentials.json`."""

    lab: str  # first part of the lab's network keys
    endpoint: str  # where the host listens
    role: str  # one of ROLES
    name: str
    fingerprint: str  # SHA-256 of the certificate
    expires: str  # ISO 8601, UTC

    @property
    def common_name(self) -> str:
        """Common name in the certificate; it contains the role, so a name alone gives no rights."""
        return common_name(self.role, self.name)

    @property
    def ending(self) -> str | None:
        """Warning about keys that have expired or expire soon; None: no warning."""
        now = datetime.datetime.now(datetime.UTC)  # noqa: TID251  (certificates go by the date)
        left = datetime.datetime.fromisoformat(self.expires) - now
        if left > SOON:
            return None
        verb = "expire" if left > datetime.timedelta() else "have expired"
        return f"the keys of {self.common_name} {verb} on {self.expires[:10]}: docs/lab_keys.md"


def common_name(role: str, name: str) -> str:
    """Common name of a party's certificate, and the name of its folder."""
    return role if role in ("host", "table") else f"{role}-{name}"


def read_credentials(folder: Path) -> Credentials:
    """Read the credentials of a key folder.

    Raises:
        CredentialsError: it is not a key folder, or others can read its private key.
    """
    made = "expected a folder that `testbed lab-keys` has made"
    try:
        tree = json.loads((folder / CREDENTIALS).read_bytes())
        credentials = Credentials(**tree)
    except OSError as error:
        raise CredentialsError(f"no keys in {folder}: {error.strerror}; {made}") from None
    except (ValueError, TypeError, RecursionError):
        raise CredentialsError(f"{folder / CREDENTIALS} cannot be read; {made}") from None
    if not all(isinstance(word, str) for word in credentials) or not _is_sound(credentials):
        raise CredentialsError(f"{folder / CREDENTIALS} has a missing or wrong field; {made}")
    for name in (AUTHORITY, CERTIFICATE, KEY):
        if not (folder / name).is_file():
            raise CredentialsError(f"{folder / name} is missing; {made}")
    if (mode := (folder / KEY).stat().st_mode & 0o777) & OPEN_MODE:
        raise CredentialsError(
            f"{folder / KEY} can be read by others (mode {mode:o}, expected 600): try"
            f" `chmod 600 {folder / KEY}`; if others have read it, make new keys"
        )
    return credentials


def _is_sound(credentials: Credentials) -> bool:
    try:
        dated = datetime.datetime.fromisoformat(credentials.expires).tzinfo is not None
    except ValueError:
        dated = False
    return dated and credentials.role in ROLES


def tls(folder: Path) -> dict[str, object]:
    """Zenoh's TLS settings: use these keys, and require a certificate of every other party."""
    at = folder.absolute()
    key, certificate = str(at / KEY), str(at / CERTIFICATE)
    return {
        "root_ca_certificate": str(at / AUTHORITY),
        "enable_mtls": True,
        "verify_name_on_connect": True,
        "listen_private_key": key,
        "listen_certificate": certificate,
        "connect_private_key": key,
        "connect_certificate": certificate,
    }


def is_local(endpoint: str) -> bool:
    """Whether an endpoint can be reached only from this machine."""
    protocol, _, rest = endpoint.partition("/")
    if protocol == "unixsock-stream":
        return True
    address = rest.partition("?")[0].partition("#")[0]
    host = address.rpartition(":")[0].strip("[]")
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def is_endpoint(endpoint: str) -> bool:
    """Whether a text has the form of an endpoint; nothing is connected."""
    protocol, _, rest = endpoint.partition("/")
    if protocol == "unixsock-stream":
        return bool(rest)
    host, _, port = rest.partition("?")[0].partition("#")[0].rpartition(":")
    whole = port.isascii() and port.isdecimal() and int(port[:6]) < 65536
    return protocol in PROTOCOLS and bool(host) and whole


class Untrusted(NamedTuple):
    """Why an endpoint must not be opened."""

    about: str
    expected: str

    def __str__(self) -> str:
        return f"{self.about}: expected {self.expected}"


def untrusted(endpoint: str, keys: Path | None) -> Untrusted | None:
    """Why an endpoint must not be opened with these keys; None: it may be."""
    if not is_endpoint(endpoint):
        example = "tcp/127.0.0.1:7450" if keys is None else "tls/192.168.1.2:7450"
        return Untrusted("not an endpoint", f"PROTOCOL/HOST:PORT, such as {example}")
    protocol, _, address = endpoint.partition("/")
    if keys is None:
        if is_local(endpoint):
            return None
        local = "a loopback address, or keys (`testbed lab-keys`) and an endpoint that begins with"
        return Untrusted("without keys only this machine is trusted", f"{local} tls/")
    if protocol not in ("tls", "quic"):
        return Untrusted("keys need a tls endpoint", f"tls/{address}")
    return None


def neighbour(folder: Path, role: str, name: str) -> Path:
    """The folder of another party next to this one, on the machine that made the keys."""
    return folder.parent / common_name(role, name)


def known(parties: Iterable[Credentials], role: str) -> list[str]:
    """Names of all parties in this role."""
    return [party.name for party in parties if party.role == role]
