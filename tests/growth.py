"""What a great many messages leave behind in memory."""

import tracemalloc
from collections.abc import Callable


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
    before, _ = tracemalloc.get_traced_memory()
    for _ in range(count // 2):
        feed()
    after, _ = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    return after - before
