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
from testbed.logs.packing import form, leaves, only

RESPONSES = {one.value: one.name.lower() for one in Response}
EVERY_NS = 500_000_000  # of the run
SELDOM_NS = 5_000_000_000  # between two pressures
TABLE = "table"  # frame of the table
OK, WARN, ERROR = 0, 1, 2  # levels of a diagnosis
BARE = struct.Struct("<4s" + form("Tick"))
# of each tick only these are unpacked
CONDITION = only(
    "Tick", "outputs.fault", "outputs.inhibit", "outputs.response", "outputs.state_known"
)
PLACE = {name: k + 1 for k, name in enumerate(leaves("Tick"))}


class Extra(NamedTuple):
    """A standard ROS message, made from rows, with its topic."""

    topic: str
    kind: str
    data: bytes


class Forms(NamedTuple):
    """The layouts of a vehicle's messages, in which only numbers change."""

    pose: cdr.Form
    wrench: cdr.Form
    transform: cdr.Form
    supply: cdr.Form


def forms_of(name: str) -> Forms:
    """The layouts for a vehicle."""
    moved = {"header": {"frame_id": TABLE}, "child_frame_id": name}
    return Forms(
        cdr.Form(POSE_KIND, {"header": {"frame_id": TABLE}}),
        cdr.Form(WRENCH_KIND, {"header": {"frame_id": name}}),
        cdr.Form(TF_KIND, {"transforms": [moved]}),
        cdr.Form(SUPPLY_KIND, {"header": {"frame_id": name}}),
    )


class Extras:
    """Makes standard messages from rows.

    Args:
        every_ns: time of the run between two poses; 0: one per tick.
    """

    def __init__(self, every_ns: int = EVERY_NS) -> None:
        self.epoch, self._every = 0, every_ns  # the first: UTC at time 0 of the run [ns]
        self._due: dict[str, int] = {}  # next message by topic [ns]
        self._state: dict[str, list[int]] = {}  # condition in the newest diagnosis
        self._forms: dict[str, Forms] = {}  # by vehicle

    def of(self, topic: str, kind: str, stamp: int, data: bytes) -> Iterator[Extra]:
        """Messages to add after a row."""
        if kind != "Tick" or not topic.endswith("/tick"):
            return
        name = topic.split("/")[1]
        *state, known = CONDITION.unpack_from(data)
        if self._state.get(name) != state:
            self._state[name] = state
            yield self._diagnosis(name, stamp, *state)
        if stamp < self._due.get(topic, 0) or not known:
            return
        self._due[topic] = stamp + self._every - self._every // 100  # times of ticks are rounded
        values = BARE.unpack_from(data)
        forms = self._forms.get(name) or self._forms.setdefault(name, forms_of(name))
        valid = self._utc(stamp + round(1e9 * (values[VALID] - values[NOW])))
        x, y, theta = values[POSE : POSE + 3]
        place = x, y, 0.0, 0.0, 0.0, math.sin(0.5 * theta), math.cos(0.5 * theta)
        fx, fy, tau = values[WRENCH : WRENCH + 3]
        yield Extra(f"/{name}/pose", POSE_KIND, forms.pose.pack(*valid, *place))
        wrench = fx, fy, 0.0, 0.0, 0.0, tau
        yield Extra(f"/{name}/wrench", WRENCH_KIND, forms.wrench.pack(*valid, *wrench))
        yield Extra("/tf", TF_KIND, forms.transform.pack(*valid, *place))

        if stamp >= self._due.get(f"{topic}/slow", 0):
            self._due[f"{topic}/slow"] = stamp + SELDOM_NS - SELDOM_NS // 100
            supply = forms.supply.pack(*self._utc(stamp), values[SUPPLY], 0.0)
            yield Extra(f"/{name}/supply", SUPPLY_KIND, supply)

    def _utc(self, stamp: int) -> tuple[int, int]:
        """A time of the run in UTC: s, ns."""
        return divmod(self.epoch + stamp, 10**9)

    def _diagnosis(self, name: str, stamp: int, fault: int, inhibit: int, response: int) -> Extra:
        level = ERROR if fault or response > Response.HOLD else WARN if response else OK
        codes = {"response": response, "fault": fault, "inhibit": inhibit}
        status = {
            "level": level, "name": name, "hardware_id": name,
            "message": RESPONSES[response],
            "values": [{"key": key, "value": str(value)} for key, value in codes.items()],
        }  # fmt: skip
        sec, nanosec = self._utc(stamp)
        header = {"stamp": {"sec": sec, "nanosec": nanosec}}
        array = {"header": header, "status": [status]}
        return Extra("/diagnostics", DIAGNOSIS, cdr.encode(DIAGNOSIS, array))


POSE_KIND, WRENCH_KIND = "geometry_msgs/PoseStamped", "geometry_msgs/WrenchStamped"
SUPPLY_KIND, TF_KIND = "sensor_msgs/FluidPressure", "tf2_msgs/TFMessage"
DIAGNOSIS = "diagnostic_msgs/DiagnosticArray"
POSE, WRENCH = PLACE["outputs.state.pose.x"], PLACE["outputs.commanded_wrench.fx"]
NOW, VALID = PLACE["outputs.t"], PLACE["outputs.state.t"]
SUPPLY = PLACE["inputs.health.supply_pressure"]
