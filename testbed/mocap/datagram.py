"""Datagrams stamped by the kernel when they arrive, so that it does not matter when one looks."""

import socket
import struct

from testbed.realtime.wall_clock import monotonic_ns, monotonic_of_wall

SO_TIMESTAMPNS = 35  # Linux, asm-generic/socket.h; Python does not name it
TIMESPEC = struct.Struct("qq")
LARGEST = 65507  # [bytes] of a UDP datagram


def stamped(host: str, port: int, *, shared: bool = False) -> socket.socket:
    """A non-blocking UDP socket; the kernel stamps each datagram with its time of arrival.

    Raises:
        OSError: the address is not one of this machine's, or the port is taken.
    """
    one = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    if shared:
        one.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    one.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)
    one.setblocking(False)
    try:
        one.bind((host, port))
    except OSError:
        one.close()
        raise
    return one


def receive(one: socket.socket) -> tuple[bytes, int, str] | None:
    """The next datagram, its arrival on the monotonic clock [ns], and its sender; None: none."""
    try:
        data, ancillary, _, (host, _) = one.recvmsg(LARGEST, 64)
    except (BlockingIOError, ConnectionRefusedError):
        return None
    for level, kind, value in ancillary:
        if level == socket.SOL_SOCKET and kind == SO_TIMESTAMPNS:
            seconds, rest = TIMESPEC.unpack_from(value)
            return data, monotonic_of_wall(seconds * 1_000_000_000 + rest), host
    return data, monotonic_ns(), host
