"""The newest picture, and what each reader has not seen yet.

A reader asks for what is new since the version that it has. A slow reader asks less often: it gets
the newest picture with everything it missed, and nothing waits for it.
"""

from collections import deque
from threading import Condition
from time import monotonic
from typing import Any, NamedTuple

import msgspec

KEPT = 100  # versions, about 10 s; an older reader gets the whole picture
TRAIL = 3000  # points kept of all trails together
RASTER_S = 10.0
EVENTS = 200  # lines kept


class Update(NamedTuple):
    """What one version added."""

    version: int
    pulses: list[Any]
    trail: list[Any]
    events: list[Any]


class Hub:
    """Hands out pictures to any number of threads."""

    def __init__(self) -> None:
        self._changed = Condition()
        self._version = 0
        self._now: dict[str, Any] = {}
        self._status: dict[str, Any] = {}  # what changes without a new picture
        self._drawn_at: float | None = None  # when the newest message of the flight was read
        self._parts: deque[Update] = deque(maxlen=KEPT)
        self._pulses: deque[Any] = deque()
        self._trail: list[Any] = []
        self._events: deque[Any] = deque(maxlen=EVENTS)

    def put(self, now: dict[str, Any], part: tuple[list[Any], list[Any], list[Any]]) -> None:
        """A new picture; `part` holds its new pulses, trail points and events."""
        with self._changed:
            self._version += 1
            self._now, self._drawn_at = now, monotonic()
            self._parts.append(Update(self._version, *part))
            self._pulses += part[0]
            while self._pulses and self._pulses[0].shut < now["t"] - RASTER_S:
                self._pulses.popleft()
            self._trail += part[1]
            if len(self._trail) > TRAIL:
                self._trail = [*self._trail[: TRAIL // 2 : 2], *self._trail[TRAIL // 2 :]]
            self._events += part[2]
            self._changed.notify_all()

    def set_status(self, **status: Any) -> None:
        """Change the status; readers get it with their next picture."""
        with self._changed:
            if {**self._status, **status} != self._status:
                self._status.update(status)
                self._version += 1
                self._parts.append(Update(self._version, [], [], []))
                self._changed.notify_all()

    def newest(self, after: int, wait_s: float) -> bytes:
        """The newest picture as JSON, once it is newer than `after`, or after `wait_s`."""
        with self._changed:
            self._changed.wait_for(lambda: self._version > after, wait_s)
            oldest = self._parts[0].version if self._parts else 1
            anew = not oldest - 1 <= after <= self._version
            missed = [] if anew else [part for part in self._parts if part.version > after]
            age = None if self._drawn_at is None else monotonic() - self._drawn_at
            answer = {
                "v": self._version,
                "anew": anew,
                "age": age,
                **self._status,
                "now": self._now,
                "pulses": [*self._pulses] if anew else [p for m in missed for p in m.pulses],
                "trail": self._trail if anew else [p for m in missed for p in m.trail],
                "events": [*self._events] if anew else [e for m in missed for e in m.events],
            }
            return msgspec.json.encode(answer)
