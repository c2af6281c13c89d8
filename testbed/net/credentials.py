"""A key folder: who somebody is on the network, and how they show it.

    badge.json        who it is, of which lab, where the host listens, until when
    authority.pem     the lab's authority: whoever it has not signed is nobody
    certificate.pem   what is shown
    private.key       what proves it; for its owner's eyes only

`testbed lab-keys` makes one folder per party; whoever has the folder is that party. Nothing here
loads more than the standard library: `testbed stop` is in a hurry.
"""

import datetime
import ipaddress
import json
from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

BADGE, AUTHORITY, CERTIFICATE, KEY = (
    "badge.json", "authority.pem", "certificate.pem", "private.key",
)  # fmt: skip
ROLES = ("host", "table", "vehicle", "operator", "watcher")
PROTOCOLS = ("tcp", "tls", "quic", "udp", "ws")  # of Zenoh's, with a host and a port
OPEN_MODE = 0o077  # bits of a private key's mode that should not be there


SOON = datetime.timedelta(days=30)  # keys that expire in less are spoken of


class BadgeError(Exception):
    """This is no key folder, or not one to be used."""


class Credentials(NamedTuple):
    """One party."""

    lab: str  # first part of its keys
    endpoint: str  # where the host listens
    role: str  # one of ROLES
    name: str
    fingerprint: str  # SHA-256 of the certificate
    expires: str  # ISO 8601, UTC

    @property
    def common_name(self) -> str:
        """As the certificate says it; the role is in it, so a name alone gives no rights."""
        return common_name(self.role, self.name)

    @property
    def ending(self) -> str | None:
        """Words about keys that expire soon, or have; None: there is time."""
        now = datetime.datetime.now(datetime.UTC)  # noqa: TID251  (certificates go by the date)
        left = datetime.datetime.fromisoformat(self.expires) - now
        if left > SOON:
            return None
        verb = "expire" if left > datetime.timedelta() else "have expired"
        return f"the keys of {self.common_name} {verb} on {self.expires[:10]}: docs/lab_keys.md"


def common_name(role: str, name: str) -> str:
    """Of a party's certificate, and of its folder."""
    return role if role in ("host", "table") else f"{role}-{name}"


def read_badge(folder: Path) -> Credentials:
    """Whose folder this is.

    Raises:
        BadgeError: it is none, or others can read its private key.
    """
    made = "expected a folder that `testbed lab-keys` has made"
    try:
        tree = json.loads((folder / BADGE).read_bytes())
        badge = Credentials(**tree)
    except OSError as error:
        raise BadgeError(f"no keys in {folder}: {error.strerror}; {made}") from None
    except (ValueError, TypeError, RecursionError):
        raise BadgeError(f"{folder / BADGE} says nothing that can be read; {made}") from None
    if not all(isinstance(word, str) for word in badge) or not _is_sound(badge):
        raise BadgeError(f"{folder / BADGE} does not say who it is, and until when; {made}")
    for name in (AUTHORITY, CERTIFICATE, KEY):
        if not (folder / name).is_file():
            raise BadgeError(f"{folder / name} is missing; {made}")
    if (mode := (folder / KEY).stat().st_mode & 0o777) & OPEN_MODE:
        raise BadgeError(
            f"{folder / KEY} can be read by others (mode {mode:o}, expected 600): try"
            f" `chmod 600 {folder / KEY}`; if others have read it, make new keys"
        )
    return badge


def _is_sound(badge: Credentials) -> bool:
    try:
        dated = datetime.datetime.fromisoformat(badge.expires).tzinfo is not None
    except ValueError:
        dated = False
    return dated and badge.role in ROLES


def tls(folder: Path) -> dict[str, object]:
    """Zenoh's settings for showing this badge and for asking everybody else for theirs."""
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
    """Whether only this machine can reach it."""
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
    """Whether it has the form of one; who is there is another question."""
    protocol, _, rest = endpoint.partition("/")
    if protocol == "unixsock-stream":
        return bool(rest)
    host, _, port = rest.partition("?")[0].partition("#")[0].rpartition(":")
    whole = port.isascii() and port.isdecimal() and int(port[:6]) < 65536
    return protocol in PROTOCOLS and bool(host) and whole


def trouble(endpoint: str, keys: Path | None) -> str | None:
    """Why nobody should listen or dial there with these keys, or None."""
    if not is_endpoint(endpoint):
        example = "tcp/127.0.0.1:7450" if keys is None else "tls/192.168.1.2:7450"
        return f"that is no endpoint: expected PROTOCOL/HOST:PORT, such as {example}"
    if keys is None:
        if is_local(endpoint):
            return None
        return (
            "without keys only this machine is to be trusted: expected an address of loopback, or"
            " keys (`testbed lab-keys`) and an endpoint that begins with tls/"
        )
    if endpoint.partition("/")[0] not in ("tls", "quic"):
        return f"keys are of no use there: expected tls/{endpoint.partition('/')[2]}"
    return None


def neighbour(folder: Path, role: str, name: str) -> Path:
    """The folder of another party, where all are still together."""
    return folder.parent / common_name(role, name)


def known(badges: Iterable[Credentials], role: str) -> list[str]:
    """Names of everybody in this role."""
    return [badge.name for badge in badges if badge.role == role]
