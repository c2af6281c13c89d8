"""A node of ROS 2 on Zenoh, without ROS: keys, tokens and attachments as rmw_zenoh has them.

    a topic's messages   <domain>/<topic>/<type>/<type hash>
    token of a node      @ros2_lv/<domain>/<session>/0/0/NN/%/%/<node>
    of a publisher       @ros2_lv/<domain>/<session>/0/<number>/MP/%/%/<node>/<topic>/<type>/
                         <type hash>/<quality of service>

In a token `%` stands for `/`. The quality of service is written as a difference from rmw_zenoh's
default, which is reliable, volatile and keep last; its depth is always written. A message is CDR
with an attachment: number and time as int64, then the publisher's 16 bytes, after their count. This
is the form since ROS 2 Jazzy; Humble has no type hashes and does not match. Source: docs/design.md
and liveliness_utils.cpp of github.com/ros2/rmw_zenoh.
"""

import struct
from hashlib import blake2b
from typing import Any

import zenoh

from testbed.core.records.ros import ros_name
from testbed.core.records.type_hash import type_hash

NODE = "testbed"
QOS = "::,10:,:,:,,"  # reliable, volatile, keep last 10
GID = 16  # bytes that identify a publisher
_ATTACHMENT = struct.Struct(f"<qqB{GID}s")


def type_of(kind: str) -> str:
    """A type's name in a key, like `std_msgs::msg::dds_::String_`."""
    package, _, name = ros_name(kind).rpartition("/")
    return f"{package.replace('/', '::')}::dds_::{name}_"


def data_key(domain: int, topic: str, kind: str) -> str:
    """The key of a topic's messages."""
    return f"{domain}/{topic.strip('/')}/{type_of(kind)}/{type_hash(kind)}"


def node_token(domain: int, session: str) -> str:
    """The liveliness token of our node."""
    return f"@ros2_lv/{domain}/{session}/0/0/NN/%/%/{NODE}"


def publisher_token(domain: int, session: str, number: int, topic: str, kind: str) -> str:
    """The liveliness token of our publisher on a topic; `number` is its own in the session."""
    what = f"{topic.replace('/', '%')}/{type_of(kind)}/{type_hash(kind)}/{QOS}"
    return f"@ros2_lv/{domain}/{session}/0/{number}/MP/%/%/{NODE}/{what}"


def attachment(number: int, stamp: int, gid: bytes) -> bytes:
    """What goes with the message of this number, sent at `stamp`, UTC [ns]."""
    return _ATTACHMENT.pack(number, stamp, GID, gid)


class Ros2Node:
    """Our node in a Zenoh session; it only publishes."""

    def __init__(self, session: zenoh.Session, domain: int) -> None:
        self._session, self._domain = session, domain
        self._id = str(session.info.zid())
        self._tokens = [self._token(node_token(domain, self._id))]
        self._topics: dict[str, _Topic] = {}

    def _token(self, key: str) -> Any:
        return self._session.liveliness().declare_token(key)

    def publish(self, topic: str, kind: str, stamp: int, data: bytes) -> None:
        """Send a message.

        Args:
            topic: like `/sat1/state`.
            kind: of the message, a name in core/records.
            stamp: UTC [ns].
            data: CDR.
        """
        if (found := self._topics.get(topic)) is None:
            token = publisher_token(self._domain, self._id, len(self._tokens), topic, kind)
            self._tokens.append(self._token(token))
            key = data_key(self._domain, topic, kind)
            found = self._topics[topic] = _Topic(self._session, key, token)
        found.publish(stamp, data)


class _Topic:
    def __init__(self, session: zenoh.Session, key: str, token: str) -> None:
        # waits for a slow listener: this process has nothing else to do, and nothing is lost
        self._publisher = session.declare_publisher(
            key, congestion_control=zenoh.CongestionControl.BLOCK
        )
        self._gid = blake2b(token.encode(), digest_size=GID).digest()
        self._number = 0

    def publish(self, stamp: int, data: bytes) -> None:
        self._number += 1
        self._publisher.put(data, attachment=attachment(self._number, stamp, self._gid))
