"""Buffers rows by entity and sends them to rerun in batches.

This costs a hundredth of logging single rows. The batch size does not affect the result: the same
rows arrive at the same entities with the same times.
"""

import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
import rerun as rr
from numpy.typing import ArrayLike


class Lines(NamedTuple):
    """Lines of one entity at one time; an empty list clears the previous ones."""

    strips: Sequence[ArrayLike] = ()
    colours: Sequence[Sequence[int]] | None = None  # None: those of the static scene
    labels: Sequence[str] | None = None


class Label(NamedTuple):
    """A text label at a position on the table."""

    x: float  # [m]
    y: float  # [m]
    z: float  # [m]
    words: str
    colour: tuple[int, int, int]


def _transforms(rows: list[Any]) -> Any:
    """Columns of transforms from rows (x, y, theta)."""
    turns = [(0.0, 0.0, math.sin(theta / 2), math.cos(theta / 2)) for _, _, theta in rows]
    return rr.Transform3D.columns(translation=[(x, y, 0.0) for x, y, _ in rows], quaternion=turns)


def _lines(rows: list[Any]) -> Any:
    counts = [len(row.strips) for row in rows]
    parts = [*rr.LineStrips3D.columns(strips=[s for r in rows for s in r.strips]).partition(counts)]
    if all(row.colours is not None for row in rows):
        colours = [c for row in rows for c in row.colours]
        parts += rr.LineStrips3D.columns(colors=colours).partition(counts)
    if all(row.labels is not None for row in rows):
        labels = [words for row in rows for words in row.labels]
        parts += rr.LineStrips3D.columns(labels=labels).partition(counts)
    return parts


def _labels(rows: list[Any]) -> Any:
    return rr.Points3D.columns(
        positions=[(row.x, row.y, row.z) for row in rows],
        labels=[row.words for row in rows],
        colors=[row.colour for row in rows],
        radii=[0.001] * len(rows),
    )


MAKE: dict[str, Callable[[list[Any]], Any]] = {
    "scalar": lambda rows: rr.Scalars.columns(scalars=rows),
    "transform": _transforms,
    "lines": _lines,
    "label": _labels,
    "colour": lambda rows: rr.Mesh3D.columns(albedo_factor=np.array(rows, dtype=np.uint8)),
    "event": lambda rows: rr.TextLog.columns(
        text=[words for words, _ in rows], level=[level for _, level in rows]
    ),
    "picture": lambda rows: rr.EncodedImage.columns(
        blob=rows, media_type=["image/png"] * len(rows)
    ),
}


class ColumnBuffer:
    """A buffer of rows not yet sent."""

    def __init__(self, recording: rr.RecordingStream) -> None:
        self._rec = recording
        self._rows: dict[tuple[str, str], tuple[list[float], list[Any]]] = {}

    def add(self, kind: str, path: str, t: float, value: Any) -> None:
        """Add a row of an entity."""
        times, values = self._rows.setdefault((path, kind), ([], []))
        times.append(t)
        values.append(value)

    def send(self) -> None:
        """Send all rows and empty the buffer."""
        for (path, kind), (times, values) in self._rows.items():
            columns = [rr.TimeColumn("t", duration=times)]
            self._rec.send_columns(path, columns, MAKE[kind](values))
        self._rows = {}
