"""The lab's certificate authority: makes and renews all keys. Needs the extra `keys`.

It writes one folder per party, see `net/credentials.py`, and one for the authority's signing key,
which should stay on one machine. Keys are on the curve P-256. Only the host's certificate is valid
for a server, so no vehicle or watcher can impersonate the host.
"""

import datetime
import ipaddress
import json
import os
import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import tomli_w
from cryptography import x509
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.serialization import (
    Encoding,
    NoEncryption,
    PrivateFormat,
    load_pem_private_key,
)
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from testbed.files import write_atomic
from testbed.net.access import ACCESS, read_access
from testbed.net.credentials import (
    AUTHORITY,
    CERTIFICATE,
    CREDENTIALS,
    KEY,
    Credentials,
    CredentialsError,
    common_name,
    read_credentials,
)

AUTHORITY_DAYS = 3650
BACKDATED = datetime.timedelta(days=1)  # a vehicle's clock may be behind
LOCAL = ("localhost", "127.0.0.1", "::1")  # always in the host's certificate
HEADING = """\
# Parties that may use this lab's network. The host reads this file when a run begins; delete an
# entry to shut that party out. Written by `testbed lab-keys`; docs/lab_keys.md explains the roles.

"""

Signer = tuple[x509.Certificate, ec.EllipticCurvePrivateKey]


class Wanted(NamedTuple):
    """Parties and addresses for which keys are made."""

    lab: str
    endpoint: str
    addresses: Sequence[str]  # host names and addresses of the host
    parties: Sequence[tuple[str, str]]  # role and name
    days: int  # lifetime of the certificates


def make_keys(folder: Path, wanted: Wanted, *, force: bool) -> list[Credentials]:
    """Make keys for these parties and add them to the access list; returns their credentials.

    The authority's key is made first if it does not exist.

    Raises:
        CredentialsError: a party has keys already and `force` is not given, or the authority's key
            cannot be used.
    """
    now = datetime.datetime.now(datetime.UTC).replace(microsecond=0)  # noqa: TID251  (a date)
    for role, name in wanted.parties:
        if (folder / common_name(role, name)).exists() and not force:
            raise CredentialsError(
                f"{folder / common_name(role, name)} has keys already; --force makes new ones, and"
                " the old ones stay good until they expire"
            )
    folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    signer = _authority(folder, wanted.lab, now)
    end = min(now + datetime.timedelta(days=wanted.days), signer[0].not_valid_after_utc)
    made = []
    for role, name in wanted.parties:
        made.append(_party(folder, wanted, role, name, signer, now, end))
    _write_list(folder, wanted, made)
    return made


def listed(folder: Path) -> list[Credentials]:
    """Every party on the access list; empty if there is no list yet."""
    if not (folder / "host" / ACCESS).exists():
        return []
    return read_access(folder / "host").parties


def addresses_of(folder: Path) -> list[str]:
    """Names and addresses in the host's certificate, apart from this machine's."""
    path = folder / "host" / CERTIFICATE
    names = x509.load_pem_x509_certificate(path.read_bytes()).extensions.get_extension_for_class(
        x509.SubjectAlternativeName
    )
    return [str(one.value) for one in names.value if str(one.value) not in LOCAL]


def _authority(folder: Path, lab: str, now: datetime.datetime) -> Signer:
    place = folder / "authority"
    if place.exists():
        try:
            key = load_pem_private_key((place / KEY).read_bytes(), None)
            certificate = x509.load_pem_x509_certificate((place / CERTIFICATE).read_bytes())
        except (OSError, ValueError) as error:
            raise CredentialsError(
                f"the authority in {place} cannot be read: {error}; without it no keys can be"
                " added: restore its backup, or make new keys in another folder"
            ) from None
        assert isinstance(key, ec.EllipticCurvePrivateKey)
        if certificate.not_valid_after_utc <= now:
            raise CredentialsError(
                f"the authority in {place} expired on"
                f" {certificate.not_valid_after_utc:%Y-%m-%d}: make new keys in another folder"
            )
        return certificate, key
    key = ec.generate_private_key(ec.SECP256R1())
    name = _name(f"authority of {lab}")
    builder = _builder(name, name, key, now, now + datetime.timedelta(days=AUTHORITY_DAYS))
    usage = x509.KeyUsage(
        digital_signature=False, content_commitment=False, key_encipherment=False,
        data_encipherment=False, key_agreement=False, key_cert_sign=True, crl_sign=True,
        encipher_only=False, decipher_only=False,
    )  # fmt: skip
    certificate = (
        builder.add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
        .add_extension(usage, critical=True)
        .sign(key, hashes.SHA256())
    )
    _put(place, {KEY: _pem(key), CERTIFICATE: certificate.public_bytes(Encoding.PEM)})
    return certificate, key


def _party(
    folder: Path, wanted: Wanted, role: str, name: str, signer: Signer,
    now: datetime.datetime, end: datetime.datetime,
) -> Credentials:  # fmt: skip
    root, root_key = signer
    key = ec.generate_private_key(ec.SECP256R1())
    who = common_name(role, name)
    use = ExtendedKeyUsageOID.SERVER_AUTH if role == "host" else ExtendedKeyUsageOID.CLIENT_AUTH
    uses = [use] if role != "host" else [use, ExtendedKeyUsageOID.CLIENT_AUTH]
    builder = (
        _builder(_name(who), root.subject, key, now, end)
        .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
        .add_extension(x509.ExtendedKeyUsage(uses), critical=False)
    )
    if role == "host":
        names = [_alternative(one) for one in dict.fromkeys((*LOCAL, *wanted.addresses))]
        builder = builder.add_extension(x509.SubjectAlternativeName(names), critical=False)
    certificate = builder.sign(root_key, hashes.SHA256())
    digest = certificate.fingerprint(hashes.SHA256()).hex(":").upper()
    credentials = Credentials(wanted.lab, wanted.endpoint, role, name, digest, end.isoformat())
    _put(
        folder / who,
        {
            KEY: _pem(key),
            CERTIFICATE: certificate.public_bytes(Encoding.PEM),
            AUTHORITY: root.public_bytes(Encoding.PEM),
            CREDENTIALS: json.dumps(credentials._asdict(), indent=2).encode() + b"\n",
        },
    )
    return credentials


def _name(text: str) -> x509.Name:
    return x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, text)])


def _alternative(address: str) -> x509.GeneralName:
    try:
        return x509.IPAddress(ipaddress.ip_address(address))
    except ValueError:
        return x509.DNSName(address)


def _builder(
    subject: x509.Name, issuer: x509.Name, key: ec.EllipticCurvePrivateKey,
    now: datetime.datetime, end: datetime.datetime,
) -> x509.CertificateBuilder:  # fmt: skip
    return (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(issuer)
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - BACKDATED)
        .not_valid_after(end)
    )


def _pem(key: ec.EllipticCurvePrivateKey) -> bytes:
    return key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption())


def _put(place: Path, files: dict[str, bytes]) -> None:
    """Replace a folder in one step; its other files are kept."""
    part = place.with_name(f".{place.name}.part")
    shutil.rmtree(part, ignore_errors=True)
    if place.exists():
        shutil.copytree(place, part)
    part.mkdir(mode=0o700, exist_ok=True)
    for name, data in files.items():
        (part / name).unlink(missing_ok=True)
        mode = 0o600 if name == KEY else 0o644
        flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL
        with os.fdopen(os.open(part / name, flags, mode), "wb") as file:
            file.write(data)
    old = place.with_name(f".{place.name}.old")
    shutil.rmtree(old, ignore_errors=True)
    if place.exists():
        place.rename(old)
    part.rename(place)
    shutil.rmtree(old, ignore_errors=True)


def _write_list(folder: Path, wanted: Wanted, made: Sequence[Credentials]) -> None:
    """Add new parties to the host's access list."""
    entries = {party.common_name: party for party in (*listed(folder), *made)}
    tree = {
        "lab": wanted.lab,
        "endpoint": wanted.endpoint,
        "party": [
            {"role": b.role, "name": b.name, "fingerprint": b.fingerprint, "expires": b.expires}
            for b in entries.values()
        ],
    }
    write_atomic(folder / "host" / ACCESS, (HEADING + tomli_w.dumps(tree)).encode())


def host_credentials(folder: Path) -> Credentials | None:
    """The host's credentials; None if it has no keys."""
    return read_credentials(folder / "host") if (folder / "host").exists() else None
