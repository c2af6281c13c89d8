"""A run on ROS 2, seen by a client written after rmw_zenoh's documentation, without our code."""

import json
import struct
from collections import defaultdict

import numpy as np
import pytest
import zenoh

from patience import wait_for
from ports import free_port
from testbed.core.records.definition import MESSAGES, parse
from testbed.core.types import (
    Accel,
    Health,
    Inputs,
    Outputs,
    Pose,
    Reference,
    State,
    Tick,
    Twist,
    ValveCommand,
    Wrench,
)
from testbed.logs.log_reader import LogError, LogReader
from testbed.logs.recorder import Recorder
from testbed.logs.truth import Motion, Truth
from testbed.net.ros2 import Ros2Node
from testbed.net.ros2_publisher import publish
from testbed.net.session import dial, listen

EPOCH = 1_800_000_000 * 10**9
TICKS = 8
LATER = 0.008  # from a tick to the time of its estimate [s]


def tick(k: int) -> Tick:
    """The k-th tick of a vehicle that has no pose in its first one."""
    t, pose, twist, no_accel = (
        0.1 * k,
        Pose(0.1 * k, 2.0, 3.0),
        Twist(4.0, 5.0, 6.0),
        Accel(0, 0, 0),
    )
    state = State(t + LATER, pose, twist, Accel(7.0, 8.0, 9.0), 0.02, k) if k else None
    reference = Reference(t, pose, twist, no_accel) if k > 2 else None
    still = Wrench(0.0, 0.0, 0.0)
    return Tick(
        Inputs(t, True, (), None, {}, Health(t, 5e5, 2e7)),
        Outputs(t, state, reference, still, still, ValveCommand(k, t, t + 0.1, (k, 0), (0, 0))),
    )


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    path = tmp_path_factory.mktemp("log") / "log.mcap"
    with Recorder(path, epoch_ns=EPOCH) as recorder:
        for k in range(TICKS):
            recorder.write("/sat1/tick", 0.1 * k, tick(k))
            recorder.write("/truth", 0.1 * k, Truth(0.1 * k, {"sat1": Motion(*[0.1 * k] * 6)}))
    return path


@pytest.fixture
def router():
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    with listen(endpoint):
        yield endpoint


class Listener:
    """A node of ROS 2, by rmw_zenoh's documentation."""

    def __init__(self, endpoint):
        config = zenoh.Config()
        config.insert_json5("mode", '"client"')
        config.insert_json5("connect/endpoints", json.dumps([endpoint]))
        config.insert_json5("scouting/multicast/enabled", "false")
        self.session, self.heard = zenoh.open(config), defaultdict(list)
        self.session.declare_subscriber("7/**", self._hear)
        self.graph()  # answered after the router knows the subscriber

    def _hear(self, sample):
        number, stamp, size = struct.unpack_from("<qqB", sample.attachment.to_bytes())
        gid = sample.attachment.to_bytes()[17:]
        assert size == len(gid) == 16
        key = str(sample.key_expr)
        self.heard[key].append((number, stamp, gid, sample.payload.to_bytes()))

    def graph(self):
        """Publishers by topic: type, type hash, quality of service; and the names of nodes."""
        nodes, topics = set(), {}
        for reply in self.session.liveliness().get("@ros2_lv/7/**"):
            parts = str(reply.ok.key_expr).split("/")
            assert parts[2]
            assert parts[3] == "0"
            assert parts[6:8] == ["%", "%"]
            if parts[5] == "NN":
                nodes.add(parts[8])
            else:
                assert parts[5] == "MP"
                topics[parts[9].replace("%", "/")] = tuple(parts[10:])
        return nodes, topics


def store():
    """The types as a lab with ROS 2 builds them: from the package's files."""
    pytest.importorskip("rosbags")
    from pathlib import Path

    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    import testbed.core.records as records

    found, types = get_typestore(Stores.ROS2_JAZZY), {}
    for file in (Path(records.__file__).parent / "testbed_msgs/msg").glob("*.msg"):
        types.update(get_types_from_msg(file.read_text(), f"testbed_msgs/msg/{file.stem}"))
    found.register(types)
    return found


def never(_seconds):
    raise AssertionError("it waited")


def test_a_ros_node_sees_types_hashes_and_values(path, router):
    types, listener = store(), Listener(router)
    with listener.session, dial(router) as session:
        node = Ros2Node(session, 7)
        number = publish(LogReader(path), node, lambda: 0.0, never)
        wait_for(lambda: sum(map(len, listener.heard.values())) == number)
        nodes, topics = listener.graph()
    assert nodes == {"testbed"}
    assert topics["/sat1/state"][0] == "testbed_msgs::msg::dds_::State_"
    values = {}
    for key, heard in listener.heard.items():
        domain, *topic, kind, code = key.split("/")
        topic, name = "/" + "/".join(topic), kind.replace("::dds_::", "/").replace("::", "/")[:-1]
        assert (domain, topics[topic]) == ("7", (kind, code, "::,10:,:,:,,"))
        assert code == types.hash_rihs01(name)
        assert [one[0] for one in heard] == list(range(1, len(heard) + 1))
        assert len({gid for _, _, gid, _ in heard}) == 1
        values[topic] = [(one[1], types.deserialize_cdr(one[3], name)) for one in heard]
    assert {"/sat1/tick", "/sat1/state", "/sat1/reference", "/truth", "/names", "/tf"} <= set(
        values
    )
    states = values["/sat1/state"]
    assert [one.pose.x for _, one in states] == [0.1 * k for k in range(1, TICKS)]
    assert [one.rejected for _, one in states] == list(range(1, TICKS))
    assert states[0][1].bias.alpha == 9.0
    assert [stamp for stamp, _ in states] == [EPOCH + 10**8 * k for k in range(1, TICKS)]
    assert [one.pose.x for _, one in values["/sat1/reference"]] == [
        0.1 * k for k in range(3, TICKS)
    ]
    assert [one.pose.position.x for _, one in values["/sat1/pose"]] == [
        0.1 * k for k in range(1, TICKS)
    ]
    stamps = [10**8 * k + 8 * 10**6 for k in range(1, TICKS)]  # for which the estimate holds
    for topic in ("/sat1/pose", "/sat1/wrench"):
        assert [one.header.stamp.nanosec for _, one in values[topic]] == stamps
    assert [one.transforms[0].header.stamp.nanosec for _, one in values["/tf"]] == stamps
    assert [stamp for stamp, _ in values["/tf"]] == [EPOCH + 10**8 * k for k in range(1, TICKS)]
    ticks = [one for _, one in values["/sat1/tick"]]
    assert [one.pulses[0].on_us for one in ticks] == list(range(TICKS))
    assert np.isnan(ticks[0].outputs.state.pose.x)


class Heard:
    """A node that keeps what it is to publish."""

    def __init__(self):
        self.topics = []

    def publish(self, topic, kind, stamp, data):
        self.topics.append((topic, stamp))


def test_a_finished_run_is_published_at_its_pace(path):
    node, now = Heard(), [100.0]

    def pause(seconds):
        now[0] += seconds

    publish(LogReader(path), node, lambda: now[0], pause, speed=0.2)
    took = now[0] - 100.0
    assert took == pytest.approx(0.1 * (TICKS - 1) / 0.2, abs=0.1)
    said = [topic for topic, _ in node.topics]
    assert said.count("/names") >= 3  # for late listeners, each second
    assert said.count("/sat1/tick") == TICKS


def test_a_flight_is_followed(path, tmp_path):
    """Rows appear while it listens, and it ends with the log."""
    data, node = path.read_bytes(), Heard()
    growing = tmp_path / "log.mcap"
    growing.write_bytes(data[: len(data) // 2])

    def pause(_seconds):
        with growing.open("ab") as file:
            file.write(data[growing.stat().st_size :])

    publish(LogReader(growing), node, lambda: 0.0, pause)
    assert [topic for topic, _ in node.topics].count("/sat1/tick") == TICKS


def test_a_log_of_another_version_is_refused(path, monkeypatch):
    monkeypatch.setitem(MESSAGES, "Health", parse("Health", "float64 t"))
    with pytest.raises(LogError, match="this version"):
        publish(LogReader(path), Heard(), lambda: 0.0, never)
