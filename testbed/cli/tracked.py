"""Progress of a loop: a bar at a terminal, lines without one."""

import time
from collections.abc import Iterable, Iterator
from typing import TypeVar

from rich.progress import track

from testbed.cli.refusal import errors

LINE_S = 60.0  # interval of lines without a terminal [s]
Item = TypeVar("Item")


def tracked(items: Iterable[Item], words: str, total: int) -> Iterator[Item]:
    """The items; a bar at a terminal, otherwise a line once a minute, both on standard error."""
    if errors.is_terminal:
        yield from track(items, words, total, console=errors, transient=True)
        return
    printed = time.monotonic()
    for done, item in enumerate(items, 1):
        yield item
        if time.monotonic() - printed >= LINE_S:
            printed = time.monotonic()
            errors.print(f"{words}: {done} of {total}", markup=False, soft_wrap=True)
