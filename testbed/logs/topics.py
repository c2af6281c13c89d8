"""Contents of a log: topics, rates, gaps."""

from collections.abc import Iterable

import numpy as np
from msgspec import Struct

from testbed.logs.log_reader import Row

UNTIMED = {
    "Event",
    "Valves",
    "Names",
    "Contact",
    "diagnostic_msgs/DiagnosticArray",
}  # kinds written on events: no rate, no gaps
GAP = 1.5  # a pause longer than this multiple of the usual one is a gap


class TopicSummary(Struct, frozen=True):
    """Name, kind, count and time span of one topic."""

    topic: str
    kind: str  # name of its schema
    messages: int
    rate_hz: float | None  # null: fewer than two messages, or a kind without a rate
    first_s: float
    last_s: float
    gaps: int
    longest_gap_s: float | None
    megabytes: float  # before compression


class Contents(Struct, frozen=True):
    """All topics of a log, and damage."""

    finished: bool  # false: its writer was killed or still runs
    topics: list[TopicSummary]
    damage: list[str]  # messages about missing parts


def survey(rows: Iterable[Row], kinds: dict[str, str]) -> list[TopicSummary]:
    """Count the messages; `kinds` is complete after the last row."""
    stamps: dict[str, list[int]] = {}
    sizes: dict[str, int] = {}
    for topic, stamp, data in rows:
        stamps.setdefault(topic, []).append(stamp)
        sizes[topic] = sizes.get(topic, 0) + len(data)
    return [_topic(name, kinds.get(name, ""), stamps[name], sizes[name]) for name in sorted(stamps)]


def _topic(name: str, kind: str, stamps: list[int], size: int) -> TopicSummary:
    steps = np.diff(np.array(stamps)) * 1e-9
    usual = float(np.median(steps)) if len(steps) and kind not in UNTIMED else 0.0
    long = steps[steps > GAP * usual] if usual > 0.0 else steps[:0]
    return TopicSummary(
        name,
        kind,
        len(stamps),
        1.0 / usual if usual > 0.0 else None,
        stamps[0] * 1e-9,
        stamps[-1] * 1e-9,
        len(long),
        float(long.max()) if len(long) else None,
        size / 1e6,
    )
