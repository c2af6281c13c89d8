"""Draws /scene and /tf of a log as a 3D panel shows them from above.

Messages are read by mcap_ros2, and nothing of the testbed is used: what is missing or wrong in the
log is missing or wrong in the picture.

    python tests/scene_picture.py LOG SECONDS PICTURE
"""

import math
import sys
from pathlib import Path
from typing import Any, NamedTuple

from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from PIL import Image, ImageDraw

CUBE, CYLINDER, TEXT = 1, 3, 9  # visualization_msgs/Marker
SIZE = 726  # of the picture, in pixels
MARGIN = 1.1  # width of the picture in that of the table
PAPER, GRID, INK = (255, 255, 255), (200, 200, 200), (20, 20, 20)
CORNERS = [(-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5)]
ROUND = [(0.5 * math.cos(k * math.pi / 36), 0.5 * math.sin(k * math.pi / 36)) for k in range(72)]


class Place(NamedTuple):
    """A pose in the plane of the table, with a height."""

    x: float
    y: float
    z: float
    turn: float

    def of(self, x: float, y: float) -> tuple[float, float]:
        """Where a point of this frame is on the table."""
        c, s = math.cos(self.turn), math.sin(self.turn)
        return self.x + c * x - s * y, self.y + s * x + c * y

    def then(self, inner: "Place") -> "Place":
        """A place that is given in this one."""
        x, y = self.of(inner.x, inner.y)
        return Place(x, y, self.z + inner.z, self.turn + inner.turn)


def place(position: Any, turn: Any) -> Place:
    """From a message's position and quaternion, which turns about z only."""
    if abs(turn.x) > 1e-9 or abs(turn.y) > 1e-9:
        raise ValueError(f"expected a turn about z, found {turn}")
    return Place(position.x, position.y, position.z, 2.0 * math.atan2(turn.z, turn.w))


class View(NamedTuple):
    """The table from above, x to the right and y up."""

    wide: float  # of what is shown [m]

    def pixel(self, x: float, y: float) -> tuple[float, float]:
        """Where a point of the table is in the picture."""
        scale = SIZE / self.wide
        return scale * (0.5 * self.wide + x), scale * (0.5 * self.wide - y)


def view_of(markers: list[Any]) -> View:
    """The view that shows the whole table."""
    (table,) = [one for one in markers if one.ns == "table"]
    return View(MARGIN * max(table.scale.x, table.scale.y))


def read(log: Path, seconds: float) -> tuple[list[Any], dict[str, Place]]:
    """Markers, and the newest place of each frame in that of the table, this long after the start.

    Markers come once and last; a frame moves with its newest transform.
    """
    markers: list[Any] = []
    frames = {"table": Place(0.0, 0.0, 0.0, 0.0)}
    with log.open("rb") as file:
        reader: Any = make_reader(file, decoder_factories=[DecoderFactory()])
        began = reader.get_summary().statistics.message_start_time
        for one in reader.iter_decoded_messages(["/scene", "/tf"]):
            if one.message.log_time - began > round(1e9 * seconds):
                break
            if one.channel.topic == "/scene":
                markers += one.decoded_message.markers
                continue
            for moved in one.decoded_message.transforms:
                if moved.header.frame_id != "table":
                    raise ValueError(f"expected transforms from `table`, found {moved.header}")
                to = moved.transform
                frames[moved.child_frame_id] = place(to.translation, to.rotation)
    return markers, frames


def draw(log: Path, seconds: float) -> Image.Image:
    """The picture; a marker whose frame has no transform is an error, as in the panel."""
    markers, frames = read(log, seconds)
    view = view_of(markers)
    picture = Image.new("RGB", (SIZE, SIZE), PAPER)
    pen = ImageDraw.Draw(picture, "RGBA")  # mixes colours
    shapes = []
    for one in markers:
        if (frame := frames.get(one.header.frame_id)) is None:
            raise ValueError(f"no transform from `table` to `{one.header.frame_id}`")
        at = frame.then(place(one.pose.position, one.pose.orientation))
        shapes.append((at.z + 0.5 * one.scale.z, at, one))
    for _, at, one in sorted(shapes, key=lambda shape: shape[0]):  # what is on top comes last
        rgba = one.color.r, one.color.g, one.color.b, one.color.a
        colour = tuple(round(255 * part) for part in rgba)
        if one.type == TEXT:
            pen.text(
                view.pixel(at.x, at.y - 0.05 * view.wide),
                one.text,
                fill=INK,
                anchor="mm",
                font_size=18,
            )
            continue
        outline = {CUBE: CORNERS, CYLINDER: ROUND}[one.type]
        points = [view.pixel(*at.of(one.scale.x * x, one.scale.y * y)) for x, y in outline]
        pen.polygon(points, fill=colour)
        if one.ns == "table":
            x, y = 0.5 * one.scale.x, 0.5 * one.scale.y
            for k in range(-int(x), int(x) + 1):
                pen.line((*view.pixel(k, -y), *view.pixel(k, y)), fill=GRID)
            for k in range(-int(y), int(y) + 1):
                pen.line((*view.pixel(-x, k), *view.pixel(x, k)), fill=GRID)
    return picture


if __name__ == "__main__":
    draw(Path(sys.argv[1]), float(sys.argv[2])).save(sys.argv[3], optimize=True)
