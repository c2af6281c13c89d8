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
WHITE = (1.0, 1.0, 1.0, 1.0)


def scene_of(experiment: Experiment) -> bytes:
    """All markers of an experiment, which last for the whole log.

    Vehicles move with /tf; an obstacle is where it is at first.
    """
    size = experiment.table.size
    markers = [_marker("table", TABLE, CUBE, (size[0], size[1], THICK), STONE, (0, 0, -THICK / 2))]
    for name, one in experiment.obstacles.items():
        wide = 2.0 * one.radius
        at = (*one.position, THICK / 2)
        markers.append(_marker(f"obstacles/{name}", TABLE, CYLINDER, (wide, wide, THICK), RED, at))
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
