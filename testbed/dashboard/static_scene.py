"""The static part of the dashboard's scene, and the shapes of moving objects."""

import math
from collections.abc import Sequence
from itertools import pairwise

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from testbed.config.experiment import Experiment
from testbed.core.table import Obstacle
from testbed.dashboard.legend import picture
from testbed.dashboard.limits import plot_limits
from testbed.report.goal_error import GoalError
from testbed.report.law import range_of

Array = NDArray[np.float64]

HUES = (
    (88, 166, 255),
    (255, 159, 74),
    (60, 207, 174),
    (229, 138, 212),
    (216, 198, 74),
    (159, 164, 255),
    (143, 209, 74),
    (192, 139, 255),
)
FAULTY = (225, 38, 48)  # a vehicle with a fault of its own
GREY, RED, WHITE, FLAME = (120, 130, 145), (255, 107, 107), (240, 244, 248), (255, 214, 102)
AMBER = (224, 160, 60)
AROUND = np.linspace(0.0, 2.0 * math.pi, 73)
PLUME = 0.26  # [m] drawn length for a jet that is open for the entire period
TRAIL = 600  # points
LEADER_M = 0.12  # drawn radius of a leader, which is only a point
LAYER = {
    "table": -0.02,
    "danger": 0.0,
    "trail": 0.004,
    "link": 0.006,
    "body": 0.01,
    "jet": 0.03,
    "top": 0.04,
    "cross": 0.05,
}  # [m] height, which sets the drawing order


PLOTS = (
    "error",
    "clearance",
    "speed",
    "force",
    "gas",
    "supply",
    "pose_age",
    "link",
    "loss",
    "filter",
)


def plain(text: str) -> str:
    """`text` without characters missing in the viewer's font: rerun 0.41 crashes on them."""
    return text.encode("ascii", "replace").decode()


def hue(k: int) -> tuple[int, int, int]:
    """Colour of the k-th vehicle."""
    return HUES[k % len(HUES)]


def circle(x: float, y: float, radius: float, z: float) -> Array:
    """A circle as a closed line."""
    return np.stack(
        [x + radius * np.cos(AROUND), y + radius * np.sin(AROUND), np.full(len(AROUND), z)], axis=1
    )


def disc(x: float, y: float, radius: float, z: float, colour: Sequence[int]) -> rr.Mesh3D:
    """A filled circle as a mesh of triangles."""
    rim = circle(x, y, radius, z)[:-1]
    n = len(rim)
    fan = [(n, k, (k + 1) % n) for k in range(n)]
    return rr.Mesh3D(
        vertex_positions=np.vstack([rim, [[x, y, z]]]),
        triangle_indices=fan,
        albedo_factor=list(colour),
    )


def dashes(line: Array, length: float) -> list[Array]:
    """A dashed line with strokes of about `length` [m]."""
    out = []
    for a, b in pairwise(line):
        n = max(1, round(float(np.linalg.norm(b - a)) / length))
        if n == 1:
            out.append(np.stack([a, b]))
            continue
        ends = [a + (b - a) * k / n for k in range(n + 1)]
        out += [np.stack([ends[k], ends[k + 1]]) for k in range(0, n, 2)]
    return out


def setting(rec: rr.RecordingStream, scenario: Experiment) -> None:
    """Draw table, fence, obstacles, goals, and each vehicle's shape."""
    log = rec.log
    half_x, half_y = scenario.table.size[0] / 2, scenario.table.size[1] / 2
    log("world", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    z = LAYER["table"]
    log(
        "world/table",
        rr.Mesh3D(
            vertex_positions=[
                [-half_x, -half_y, z],
                [half_x, -half_y, z],
                [half_x, half_y, z],
                [-half_x, half_y, z],
            ],
            triangle_indices=[(0, 1, 2), (0, 2, 3)],
            albedo_factor=[38, 46, 58, 255],
        ),
        static=True,
    )
    rim = [
        [-half_x, -half_y, 0],
        [half_x, -half_y, 0],
        [half_x, half_y, 0],
        [-half_x, half_y, 0],
        [-half_x, -half_y, 0],
    ]
    log("world/table/rim", rr.LineStrips3D([rim], colors=[GREY], radii=0.012), static=True)
    inset = max(s.model.radius for s in scenario.vehicles.values())
    inset += scenario.flight.gate.fence_margin
    fence = [
        [math.copysign(abs(x) - inset, x), math.copysign(abs(y) - inset, y), 0.002]
        for x, y, _ in rim
    ]
    log(
        "world/fence",
        rr.LineStrips3D(dashes(np.array(fence), 0.09), colors=[(200, 160, 80)], radii=0.006),
        static=True,
    )
    for k, name in enumerate(scenario.vehicles):
        vehicle(rec, scenario, k, name)
    for name, rock in scenario.obstacles.items():
        obstacle(rec, name, rock)
    moving_goals(rec, scenario)
    log("world/link", rr.LineStrips3D.from_fields(
        radii=[0.005], show_labels=range_of(scenario) is not None), static=True)  # fmt: skip
    _plots(rec, scenario)


def _plots(rec: rr.RecordingStream, scenario: Experiment) -> None:
    """The looks of all series, and the legend."""
    legend: list[tuple[str, tuple[int, int, int], bool]] = []
    for k, name in enumerate(scenario.vehicles):
        pale = tuple(c // 2 for c in hue(k))
        legend.append((plain(name), hue(k), False))
        for jet in range(len(scenario.vehicles[name].model.jets)):
            words = plain(f"{name} jet {jet + 1}")
            dots = rr.SeriesPoints(colors=[hue(k)], names=words, markers="square", marker_sizes=3)
            rec.log(f"plot/valve/{name}_{jet + 1}", dots, static=True)
        for what in PLOTS:
            style = rr.SeriesLines(colors=[hue(k)], names=plain(name), widths=2)
            rec.log(f"plot/{what}/{name}", style, static=True)
        for path, words in (
            (f"plot/force/{name}_delivered", f"{name} delivered"),
            (f"plot/link/{name}_setpoints", f"to {name}"),
            (f"plot/loss/{name}_setpoints", f"to {name}"),
        ):
            style = rr.SeriesLines(colors=[pale], names=plain(words), widths=1)
            rec.log(path, style, static=True)
    for limit in plot_limits(scenario):
        style = rr.SeriesLines(
            colors=[RED if limit.ends else AMBER], names=plain(limit.name), widths=1.5
        )
        rec.log(limit.path, style, static=True)
    shades = [("dark: delivered, or to the vehicle", (90, 96, 104), True)]
    lines = [("warns", AMBER, True), ("ends the flight", RED, True)]
    image = picture([*legend, *shades, *lines])
    rec.log("legend", rr.EncodedImage(contents=image, media_type="image/png"), static=True)


def vehicle(rec: rr.RecordingStream, scenario: Experiment, k: int, name: str) -> None:
    """Draw one vehicle to scale: body, heading, nozzles, rim; and its goal."""
    setup, log = scenario.vehicles[name], rec.log
    model, colour = setup.model, hue(k)
    body = np.array([[j.position[0], j.position[1], 0.0] for j in model.jets] or [[0.1, 0.1, 0.0]])
    size = float(np.abs(body[:, :2]).max())
    cut = 0.62 * size
    corners = [
        (size, cut),
        (cut, size),
        (-cut, size),
        (-size, cut),
        (-size, -cut),
        (-cut, -size),
        (cut, -size),
        (size, -cut),
    ]
    points = np.array([[x, y, LAYER["body"]] for x, y in corners] + [[0, 0, LAYER["body"]]])
    fan = [(8, i, (i + 1) % 8) for i in range(8)]
    log(
        f"world/vehicle/{name}/body",
        rr.Mesh3D(vertex_positions=points, triangle_indices=fan),  # its colour changes
        static=True,
    )
    for path, paint, width in (
        (f"world/vehicle/{name}/cross", (*WHITE, 255), 0.022),
        (f"world/trail/{name}", (*colour, 190), 0.009),
        (f"world/reference/{name}", (*WHITE, 255), 0.006),
        (f"world/stop/{name}", (*RED, 255), 0.006),
    ):
        log(path, rr.LineStrips3D.from_fields(colors=[paint], radii=[width]), static=True)
    z = LAYER["top"]
    nose, wing, notch = 0.9 * size, (-0.6 * size, 0.62 * size), -0.25 * size
    arrow = [[nose, 0, z], [*wing, z], [notch, 0, z], [wing[0], -wing[1], z]]
    log(
        f"world/vehicle/{name}/heading",
        rr.Mesh3D(
            vertex_positions=arrow,
            triangle_indices=[(0, 1, 2), (0, 2, 3)],
            albedo_factor=[18, 22, 28, 255],
        ),
        static=True,
    )
    log(
        f"world/vehicle/{name}/rim",
        rr.LineStrips3D([circle(0, 0, model.radius, LAYER["body"])], colors=[colour], radii=0.006),
        static=True,
    )
    log(
        f"world/vehicle/{name}/nozzles",
        rr.Points3D(
            body + np.array([0.0, 0.0, LAYER["jet"]]), colors=[(210, 216, 224)], radii=0.014
        ),
        static=True,
    )
    if setup.path is None and not GoalError(scenario).forms:
        goal(rec, name, setup.goal, model.radius, colour)


def goal(
    rec: rr.RecordingStream,
    name: str,
    pose: tuple[float, float, float],
    radius: float,
    colour: tuple[int, int, int],
) -> None:
    """Draw a goal: a ring with a cross and an arrow."""
    x, y, theta = pose
    z = LAYER["trail"]
    tip = [[x, y, z], [x + 1.5 * radius * math.cos(theta), y + 1.5 * radius * math.sin(theta), z]]
    size = 0.4 * radius
    cross = [
        [[x - size, y - size, z], [x + size, y + size, z]],
        [[x - size, y + size, z], [x + size, y - size, z]],
    ]
    rec.log(
        f"world/goal/{plain(name)}",
        rr.LineStrips3D(
            [circle(x, y, radius, z), tip, *cross], colors=[[*colour, 150]], radii=0.007
        ),
        static=True,
    )


def moving_goals(rec: rr.RecordingStream, scenario: Experiment) -> None:
    """Draw the shapes of moving goals and of a formation's leader, about their own centres."""
    goal_error = GoalError(scenario)
    if goal_error.led:
        goal(rec, "leader", (0.0, 0.0, 0.0), LEADER_M, WHITE)
    for k, (name, setup) in enumerate(scenario.vehicles.items()):
        if setup.path is not None and not goal_error.forms:
            goal(rec, name, (0.0, 0.0, 0.0), setup.model.radius, hue(k))


def is_moving(rock: Obstacle) -> bool:
    """Whether the obstacle moves, so that every frame redraws it."""
    return rock.velocity != (0.0, 0.0)


def obstacle(rec: rr.RecordingStream, name: str, rock: Obstacle) -> None:
    """Draw danger zone and solid core; a moving obstacle about its own centre."""
    path, z = f"world/obstacle/{name}", LAYER["danger"]
    x, y = (0.0, 0.0) if is_moving(rock) else rock.position
    if is_moving(rock):
        rec.set_time("t", duration=0.0)
        rec.log(path, rr.Transform3D(translation=[*rock.position, 0.0]))
    rec.log(f"{path}/zone", disc(x, y, rock.radius, z, (66, 36, 44, 255)), static=True)
    rim = dashes(circle(x, y, rock.radius, z + 0.002), 0.08)
    rec.log(f"{path}/radius", rr.LineStrips3D(rim, colors=[RED], radii=0.009), static=True)
    if rock.solid > 0.0:
        core = disc(x, y, rock.solid, z + 0.004, (128, 84, 88, 255))
        rec.log(f"{path}/solid", core, static=True)
    rec.log(
        f"{path}/name",
        rr.Points3D(
            [[x, y, z + 0.02]], radii=0.001, labels=[plain(name)], colors=[WHITE], show_labels=True
        ),
        static=True,
    )
