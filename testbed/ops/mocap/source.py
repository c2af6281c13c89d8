"""The motion-capture system that the table file names."""

import zenoh

from testbed.core.lab import MocapWire
from testbed.ops.mocap.exposure import MocapSource
from testbed.ops.mocap.natnet_client import NatNetClient
from testbed.ops.network.keys import Keys


def make_source(wire: MocapWire, session: zenoh.Session, keys: Keys) -> MocapSource:
    """Connect to it."""
    if wire.system == "zenoh":
        from testbed.ops.mocap.topic import PoseTopic

        return PoseTopic(session, keys.pose)
    return datagrams(wire)


def datagrams(wire: MocapWire) -> MocapSource:
    """Connect to a system that needs no session of Zenoh's."""
    if wire.system == "natnet":
        return NatNetClient(wire)
    from testbed.ops.mocap.foreign import ForeignSource

    return ForeignSource(wire)
