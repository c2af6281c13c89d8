"""Opens the motion-capture system of the table file."""

import zenoh

from testbed.core.lab import MOCAP_SYSTEMS, MocapWire
from testbed.mocap.exposure import MocapSource
from testbed.mocap.natnet_client import NatNetClient
from testbed.mocap.plugged import PluggedSource
from testbed.net.keys import Keys


def make_source(wire: MocapWire, session: zenoh.Session, keys: Keys) -> MocapSource:
    """Connect to the motion-capture system."""
    if wire.system == "zenoh":
        from testbed.mocap.topic import PoseTopic

        return PoseTopic(session, keys.pose)
    return datagrams(wire)


def datagrams(wire: MocapWire) -> MocapSource:
    """Connect to a system that needs no Zenoh session.

    Raises:
        OSError: it cannot be reached, or its plug-in cannot be used.
    """
    if wire.system == "natnet":
        return NatNetClient(wire)
    if wire.system in MOCAP_SYSTEMS:
        from testbed.mocap.foreign import ForeignSource

        return ForeignSource(wire)
    return PluggedSource(wire)
