"""Standard messages of ROS 2 in the log beside our own, for tools that plot and draw.

    /<vehicle>/pose          geometry_msgs/PoseStamped      the estimate
    /<vehicle>/wrench        geometry_msgs/WrenchStamped    commanded wrench, in the body frame
    /<vehicle>/supply        sensor_msgs/FluidPressure      behind the regulator
    /tf                      tf2_msgs/TFMessage             table -> vehicle, the estimate
    /scene                   visualization_msgs/MarkerArray table, obstacles, vehicles; once
    /diagnostics             diagnostic_msgs/DiagnosticArray a vehicle's condition, when it changes

They repeat what rows have, so they are sparse: EVERY_NS. The writer's process makes them, except
/scene, which the recorder writes once.

The stamp in a header is the time at which the data are valid, as in ROS: an estimate is that of the
time at which the tick's plan begins to push, and its wrench acts from then on. That is a command
delay after the tick, which is the time of the message in the log.
"""

import math
import struct
from collections.abc import Iterator
from typing import NamedTuple

from testbed.core.codes import Response
from testbed.core.records import cdr
from testbed.core.records import standard as _standard  # noqa: F401  (fills MESSAGES)
from testbed.logs.packing import form, leaves

RESPONSES = {one.value: one.name.lower() for one in Response}
EVERY_NS = 500_000_000  # of the run
SELDOM_NS = 5_000_000_000  # between two pressures
TABLE = "table"  # frame of the table
OK, WARN, ERROR = 0, 1, 2  # levels of a diagnosis
BARE = struct.Struct("<4s" + form("Tick"))
PLACE = {name: k + 1 for k, name in enumerate(leaves("Tick"))}


class Extra(NamedTuple):
    """A standard ROS message, made from rows, with its topic."""

    topic: str
    kind: str
    data: bytes


class Extras:
    """Makes standard messages from rows.

    Args:
        every_ns: time of the run between two poses; 0: one per tick.
    """

    def __init__(self, every_ns: int = EVERY_NS) -> None:
        self.epoch, self._every = 0, every_ns  # the first: UTC at time 0 of the run [ns]
        self._due: dict[str, int] = {}  # next message by topic [ns]
        self._state: dict[str, tuple[int, ...]] = {}  # condition in the newest diagnosis

    def of(self, topic: str, kind: str, stamp: int, data: bytes) -> Iterator[Extra]:
        """Messages to add after a row."""
        if kind != "Tick" or not topic.endswith("/tick"):
            return
        name = topic.split("/")[1]
        values = BARE.unpack_from(data)
        yield from self._diagnosis(name, stamp, values)
        if stamp < self._due.get(topic, 0) or not values[KNOWN]:
            return
        self._due[topic] = stamp + self._every - self._every // 100  # times of ticks are rounded
        valid = stamp + round(1e9 * (values[VALID] - values[NOW]))
        header = self._header(valid, TABLE)
        x, y, theta = values[POSE : POSE + 3]
        turn = {"z": math.sin(0.5 * theta), "w": math.cos(0.5 * theta)}
        pose = {"position": {"x": x, "y": y}, "orientation": turn}
        stamped = {"header": header, "pose": pose}
        yield Extra(f"/{name}/pose", POSE_KIND, cdr.encode(POSE_KIND, stamped))
        fx, fy, tau = values[WRENCH : WRENCH + 3]
        wrench = {"force": {"x": fx, "y": fy}, "torque": {"z": tau}}
        stamped = {"header": self._header(valid, name), "wrench": wrench}
        yield Extra(f"/{name}/wrench", WRENCH_KIND, cdr.encode(WRENCH_KIND, stamped))
        move = {"translation": {"x": x, "y": y}, "rotation": turn}
        moved = {"header": header, "child_frame_id": name, "transform": move}
        yield Extra("/tf", TF_KIND, cdr.encode(TF_KIND, {"transforms": [moved]}))

        if stamp >= self._due.get(f"{topic}/slow", 0):
            self._due[f"{topic}/slow"] = stamp + SELDOM_NS - SELDOM_NS // 100
            supply = {"header": self._header(stamp, name), "fluid_pressure": values[SUPPLY]}
            yield Extra(f"/{name}/supply", SUPPLY_KIND, cdr.encode(SUPPLY_KIND, supply))

    def _header(self, stamp: int, frame: str) -> cdr.Message:
        sec, nanosec = divmod(self.epoch + stamp, 10**9)
        return {"stamp": {"sec": sec, "nanosec": nanosec}, "frame_id": frame}

    def _diagnosis(self, name: str, stamp: int, values: tuple[float, ...]) -> Iterator[Extra]:
        response, fault, inhibit = (int(values[k]) for k in (RESPONSE, FAULT, INHIBIT))
        state = response, fault, inhibit
        if self._state.get(name) == state:
            return
        self._state[name] = state
        level = ERROR if fault or response > Response.HOLD else WARN if response else OK
        codes = {"response": response, "fault": fault, "inhibit": inhibit}
        status = {
            "level": level, "name": name, "hardware_id": name,
            "message": RESPONSES[response],
            "values": [{"key": key, "value": str(value)} for key, value in codes.items()],
        }  # fmt: skip
        array = {"header": self._header(stamp, ""), "status": [status]}
        yield Extra("/diagnostics", DIAGNOSIS, cdr.encode(DIAGNOSIS, array))


POSE_KIND, WRENCH_KIND = "geometry_msgs/PoseStamped", "geometry_msgs/WrenchStamped"
SUPPLY_KIND, TF_KIND = "sensor_msgs/FluidPressure", "tf2_msgs/TFMessage"
DIAGNOSIS = "diagnostic_msgs/DiagnosticArray"
POSE, WRENCH = PLACE["outputs.state.pose.x"], PLACE["outputs.commanded_wrench.fx"]
NOW, VALID = PLACE["outputs.t"], PLACE["outputs.state.t"]
SUPPLY = PLACE["inputs.health.supply_pressure"]
RESPONSE, FAULT = PLACE["outputs.response"], PLACE["outputs.fault"]
INHIBIT, KNOWN = PLACE["outputs.inhibit"], PLACE["outputs.state_known"]
