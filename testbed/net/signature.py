"""Signatures with a party's keys, for messages outside Zenoh's TLS. Needs the extra `keys`.

Dates of certificates are not checked, because a vehicle's clock may be wrong and a stop must work.
"""

import base64
from pathlib import Path

from cryptography import x509
from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.serialization import Encoding, load_pem_private_key
from cryptography.x509.oid import NameOID

from testbed.net.credentials import AUTHORITY, CERTIFICATE, KEY

HASH = ec.ECDSA(hashes.SHA256())


class Signer:
    """Signs and checks texts with the keys of one folder."""

    def __init__(self, folder: Path) -> None:
        key = load_pem_private_key((folder / KEY).read_bytes(), None)
        assert isinstance(key, ec.EllipticCurvePrivateKey)
        self._key = key
        self._authority = x509.load_pem_x509_certificate((folder / AUTHORITY).read_bytes())
        own = x509.load_pem_x509_certificate((folder / CERTIFICATE).read_bytes())
        self._certificate = base64.b64encode(own.public_bytes(Encoding.DER)).decode()

    def sign(self, text: bytes) -> dict[str, str]:
        """The certificate and the signature of a text, both in base 64."""
        signature = base64.b64encode(self._key.sign(text, HASH)).decode()
        return {"certificate": self._certificate, "signature": signature}

    def signed_by(self, text: bytes, signed: dict[str, str]) -> str | None:
        """Common name of the party of this lab that signed a text; None: there is none."""
        try:
            certificate = x509.load_der_x509_certificate(base64.b64decode(signed["certificate"]))
            certificate.verify_directly_issued_by(self._authority)
            public = certificate.public_key()
            if not isinstance(public, ec.EllipticCurvePublicKey):
                return None
            public.verify(base64.b64decode(signed["signature"]), text, HASH)
            names = certificate.subject.get_attributes_for_oid(NameOID.COMMON_NAME)
            return str(names[0].value)
        except (KeyError, ValueError, TypeError, IndexError, InvalidSignature):
            return None
