"""The motion-capture system that the table file names."""

import zenoh

from testbed.core.lab import MocapWire
from testbed.ops.mocap.exposure import MocapSource
from testbed.ops.mocap.natnet_client import NatNetClient
from testbed.ops.network.keys import Keys


def make_source(wire: MocapWire, session: zenoh.Session, keys: Keys) -> MocapSource:
    """Connect to it."""
    match wire.system:
        case "natnet":
            return NatNetClient(wire)
        case "zenoh":
            from testbed.ops.mocap.topic import PoseTopic

            return PoseTopic(session, keys.pose)
        case _:
            from testbed.ops.mocap.foreign import ForeignSource

            return ForeignSource(wire)
