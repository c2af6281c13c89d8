"""What Foxglove, PlotJuggler and readers of others find in a flown log."""

import math
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader

from ros_rules import refused
from testbed.config import load
from testbed.core.records.ros import ros_name, schema_text
from testbed.logs.columns import Columns
from testbed.logs.log_reader import LogReader

FLIGHTS = [
    ["zhang2023_table"],
    ["zhang2023_table_wrench"],
    ["hold", "--speed", "100"],  # with the topic of its loop
    ["hold", "vehicles.sat1.model.mass=18.0", "table.mocap.dropout_rate=0.9"],
]


@pytest.fixture(params=FLIGHTS, ids=" ".join)
def log(request, testbed, here) -> Path:
    testbed("run", *request.param, "duration_s=2", "--out", "out")
    return Path("out/log.mcap")


def test_others_read_every_schema_and_every_message(log):
    with log.open("rb") as file:
        summary = make_reader(file).get_summary()
    for channel in summary.channels.values():
        schema = summary.schemas[channel.schema_id]
        assert (channel.message_encoding, schema.encoding) == ("cdr", "ros2msg")
        text = schema.data.decode()
        assert refused(text) == [], channel.topic
        kind = schema.name.replace("/msg/", "/").removeprefix("testbed_msgs/")
        assert (schema.name, text) == (ros_name(kind), schema_text(kind))
    topics = {channel.topic for channel in summary.channels.values()}
    assert {"/sat1/tick", "/sat1/pose", "/sat1/wrench", "/tf", "/scene", "/truth"} <= topics


def test_mcap_ros2_reads_every_message_with_its_values(log):
    reader = pytest.importorskip("mcap_ros2.reader")
    columns, seen = Columns(LogReader(log)), dict[str, int]()
    for message in reader.read_ros2_messages(str(log)):
        topic, found = message.channel.topic, message.ros_msg
        k = seen[topic] = seen.get(topic, -1) + 1
        if topic == "/sat1/tick":
            row = columns.rows[topic][k]
            ours, theirs = row["outputs"]["state"]["pose"], found.outputs.state.pose
            for name in ("x", "y", "theta"):
                mine, other = float(ours[name]), getattr(theirs, name)
                assert mine == other or (math.isnan(mine) and math.isnan(other))
            assert found.samples_valid == row["samples_valid"]
            assert [one.on_us for one in found.pulses] == row["pulses"]["on_us"].tolist()[:8]
        elif topic == "/truth":
            t, first = columns.rows[topic]["t"][k], found.vehicles[0]
            assert (found.t, first.pose.x) == (
                t,
                columns.rows[topic]["vehicles"][k][0]["pose"]["x"],
            )
        elif topic == "/sat1/pose":
            turn = found.pose.orientation
            assert math.hypot(turn.z, turn.w) == pytest.approx(1.0)
            assert found.header.frame_id == "table"
        elif topic == "/scene":
            assert found.markers[0].ns == "table"
    with log.open("rb") as file:
        summary = make_reader(file).get_summary()
    counts = summary.statistics.channel_message_counts
    names = {c.id: c.topic for c in summary.channels.values()}
    assert {names[k]: n for k, n in counts.items()} == {t: k + 1 for t, k in seen.items()}


def test_a_pose_is_that_of_the_vehicle_at_its_stamp(testbed, here):
    """Not at the tick: it is the estimate for a command delay later."""
    reader = pytest.importorskip("mcap_ros2.reader")
    words = ["vehicles.sat1.start=[-1.5,-1.0,0.0]", "vehicles.sat1.model.command_delay_s=0.03"]
    testbed("run", "hold", *words, "duration_s=20", "criteria={}", "--out", "out")
    log = LogReader(Path("out/log.mcap"))
    truth = Columns(log).rows["/truth"]
    now, pose = truth["t"], truth["vehicles"][:, 0]["pose"]

    def off(t, x, y):
        """Distance from the true pose [m]."""
        return math.hypot(x - np.interp(t, now, pose["x"]), y - np.interp(t, now, pose["y"]))

    late = dict[str, list[float]]()
    stamped, ticks = dict[str, list[float]](), dict[str, list[float]]()
    for message in reader.read_ros2_messages(str(log.path)):
        topic, found = message.channel.topic, message.ros_msg
        if topic not in ("/sat1/pose", "/tf"):
            continue
        one = found if topic != "/tf" else found.transforms[0]
        place = one.pose.position if topic != "/tf" else one.transform.translation
        at = one.header.stamp.sec * 10**9 + one.header.stamp.nanosec - log.epoch
        tick = message.log_time_ns - log.epoch
        if 1e-9 * at > now[-1]:
            continue
        late.setdefault(topic, []).append(1e-9 * (at - tick))
        stamped.setdefault(topic, []).append(off(1e-9 * at, place.x, place.y))
        ticks.setdefault(topic, []).append(off(1e-9 * tick, place.x, place.y))
    for topic in ("/sat1/pose", "/tf"):
        assert np.allclose(late[topic], 0.036)  # and 6 ms until the valve is open
        assert np.median(stamped[topic]) < 0.1 * np.median(ticks[topic])
        assert max(stamped[topic]) < 0.001


@pytest.mark.parametrize("shown", [0.6, 20.1, 37.1])  # there are transforms
def test_the_scene_shows_things_where_they_are(testbed, here, shown):
    """Drawn from /scene and /tf alone; a vehicle overlaps a danger disc, but never a solid core."""
    pytest.importorskip("PIL.Image", reason="the dashboard extra is not installed")
    from scene_picture import View, draw

    testbed("run", "zhang2023_table", "duration_s=40", "criteria={}", "--out", "out")
    picture = draw(Path("out/log.mcap"), shown)
    flown, truth = load(Path("out/config.toml")), Columns(LogReader(Path("out/log.mcap")))

    def colour(x: float, y: float) -> str:
        r, g, b = picture.getpixel(View(6.6).pixel(x, y))  # of a table of 6 m
        if min(r, g, b) > 250:
            return "paper"
        if r > 1.5 * b:
            return "core"
        return "body" if b > 1.5 * r else "danger" if r > 1.2 * b else "table"

    row = truth.rows["/truth"]
    row = row[np.searchsorted(row["t"], shown)]
    radius = flown.vehicles["sat1"].model.radius
    for pose in (one["pose"] for one in row["vehicles"][:3]):
        x, y, theta = (float(pose[name]) for name in ("x", "y", "theta"))
        beside = theta - 0.5 * math.pi  # off the white nose
        across = math.cos(beside), math.sin(beside)
        for share, is_body in ((0.2, True), (0.93, True), (1.07, False)):
            at = x + share * radius * across[0], y + share * radius * across[1]
            assert (colour(*at) == "body") is is_body
        nose = x + 0.5 * radius * math.cos(theta), y + 0.5 * radius * math.sin(theta)
        assert colour(*nose) == "paper"  # white
    for one in flown.obstacles.values():
        x, y = one.position
        assert colour(x, y) == colour(x, y + 0.9 * one.solid) == "core"
        assert colour(x, y + 1.1 * one.solid) == colour(x, y + 0.95 * one.radius) == "danger"
        assert colour(x, y + 1.05 * one.radius) == "table"
    assert colour(2.9, -2.9) == "table"
    assert colour(3.1, 0.0) == colour(0.0, -3.1) == "paper"


def test_an_obstacle_that_moves_says_that_it_is_drawn_where_it_began(testbed, here):
    pytest.importorskip("PIL.Image", reason="the dashboard extra is not installed")
    from scene_picture import TEXT, read

    testbed("run", "xue2021_table_dynamic", "duration_s=2", "criteria={}", "--out", "out")
    markers, _ = read(Path("out/log.mcap"), 1.0)
    labels = [one.text for one in markers if one.type == TEXT]
    assert labels == ["o1 at 0 s, moves", "sat1", "sat2", "sat3"]


def test_a_scene_without_a_transform_is_an_error(testbed, here, monkeypatch):
    pytest.importorskip("PIL.Image", reason="the dashboard extra is not installed")
    import scene_picture

    testbed("run", "hold", "duration_s=2", "criteria={}", "--out", "out")
    markers, frames = scene_picture.read(Path("out/log.mcap"), 1.0)
    monkeypatch.setattr(scene_picture, "read", lambda *_: (markers, {"table": frames["table"]}))
    with pytest.raises(ValueError, match="no transform from `table` to `sat1`"):
        scene_picture.draw(Path("out/log.mcap"), 1.0)


@pytest.mark.parametrize(
    ("line", "why"),
    [
        ("float64 Big", "name of a field"),
        ("float64 a__b", "name of a field"),
        ("uint8 LEVEL=256", "out of range"),
        ("uint8 level=1", "name of a constant"),
        ("geometry_msgs/Pose pose", "unknown type"),
        ("float64", "no field"),
        ("uint8[101] data", "PlotJuggler"),
    ],
)
def test_the_checker_finds_what_they_refuse(line, why):
    (found,) = refused(f"float64 t  # [s]\n{line}\n")
    assert why in found
