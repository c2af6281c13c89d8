"""What a great many messages leave behind in memory."""

import gc
import tracemalloc
from collections.abc import Callable


def in_use() -> int:
    """Bytes that are traced and not garbage: errors are, in circles, until somebody collects."""
    gc.collect()
    return tracemalloc.get_traced_memory()[0]


def growth(feed: Callable[[], object], count: int, until_full: int = 200) -> int:
    """Bytes that the second half of `count` calls has left behind.

    Args:
        feed: takes one message.
        count: of the messages.
        until_full: calls between the halves, after which bounded buffers are full.
    """
    tracemalloc.start()  # now: what replaces something untraced would look like growth
    for _ in range(count // 2 + until_full):
        feed()
    before = in_use()
    for _ in range(count // 2):
        feed()
    after = in_use()
    tracemalloc.stop()
    return after - before
