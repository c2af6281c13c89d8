"""The table, its obstacles and the vehicles as markers, for viewers of ROS."""

from typing import Any

from testbed.config import Experiment
from testbed.core.records import cdr
from testbed.core.records import standard as _standard  # noqa: F401  (fills MESSAGES)
from testbed.logs.extras import TABLE
from testbed.logs.recorder import SCENE

CUBE, CYLINDER, TEXT = 1, 3, 9  # types of markers
THICK = 0.02  # of the drawn table [m]
TALL = 0.15  # of the drawn bodies [m]
STONE, RED, BLUE = (0.75, 0.75, 0.72, 1.0), (0.8, 0.2, 0.2, 1.0), (0.2, 0.4, 0.8, 0.9)
PALE, WHITE = (0.8, 0.2, 0.2, 0.3), (1.0, 1.0, 1.0, 1.0)


def scene_of(experiment: Experiment) -> bytes:
    """All markers of an experiment, which last for the whole log.

    Vehicles move with /tf; an obstacle is where it is at first, and says so if it moves. Its solid
    core is as tall as a vehicle. The disc on the table has the danger radius, which only a
    vehicle's centre must keep.
    """
    top = (*experiment.table.size, THICK)
    markers = [_marker("table", TABLE, CUBE, top, STONE, (0, 0, -THICK / 2))]
    for name, one in experiment.obstacles.items():
        wide, core = 2.0 * one.radius, 2.0 * one.solid
        on, up = (*one.position, THICK / 2), (*one.position, TALL / 2)
        markers.append(_marker(f"danger/{name}", TABLE, CYLINDER, (wide, wide, THICK), PALE, on))
        if core > 0.0:
            size = (core, core, TALL)
            markers.append(_marker(f"obstacles/{name}", TABLE, CYLINDER, size, RED, up))
        if one.velocity != (0.0, 0.0):
            moves = _marker(f"names/{name}", TABLE, TEXT, (0, 0, 0.1), WHITE, up)
            markers.append(moves | {"text": f"{name} at 0 s, moves"})
    for name, setup in experiment.vehicles.items():
        wide = 2.0 * setup.model.radius
        body, nose = (0, 0, TALL / 2), (setup.model.radius / 2, 0, TALL)
        line, label = (setup.model.radius, 0.03, 0.02), (0, 0, 2 * TALL)
        markers += [
            _marker(f"vehicles/{name}", name, CYLINDER, (wide, wide, TALL), BLUE, body),
            _marker(f"noses/{name}", name, CUBE, line, WHITE, nose),
            _marker(f"names/{name}", name, TEXT, (0, 0, 0.1), WHITE, label) | {"text": name},
        ]
    return cdr.encode(SCENE, {"markers": markers})


def _marker(
    ns: str, frame: str, kind: int, size: tuple[float, ...], colour: tuple[float, ...],
    at: tuple[float, ...],
) -> dict[str, Any]:  # fmt: skip
    xyz = ("x", "y", "z")
    return {
        "header": {"frame_id": frame}, "ns": ns, "type": kind, "frame_locked": True,
        "pose": {"position": dict(zip(xyz, at, strict=True)), "orientation": {"w": 1.0}},
        "scale": dict(zip(xyz, size, strict=True)),
        "color": dict(zip("rgba", colour, strict=True)),
    }  # fmt: skip
