"""Ports to listen on, which nobody takes between their choice and their use.

The system gives whoever dials out a port from 32768 on, so these are below; they are drawn, because
tests run beside each other.
"""

import secrets
import socket
from contextlib import suppress


def free_port(kind: int = socket.SOCK_STREAM) -> int:
    """A port of loopback that nobody listens on."""
    while True:
        with socket.socket(socket.AF_INET, kind) as one, suppress(OSError):
            one.bind(("127.0.0.1", 16_000 + secrets.randbelow(16_000)))
            return int(one.getsockname()[1])
