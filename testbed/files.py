"""Files that are there whole or not at all: whoever looks for one never reads half of it."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def atomic_write(path: Path) -> Iterator[Path]:
    """Where to write a file that takes its place in one step, when all is written."""
    part = path.with_name(path.name + ".part")
    try:
        with named(path):
            yield part
        part.replace(path)
    finally:
        part.unlink(missing_ok=True)


@contextmanager
def named(path: Path) -> Iterator[None]:
    """What goes wrong with a file meanwhile says with which; a full disk does not say it."""
    try:
        yield
    except OSError as error:
        if error.filename is None and error.errno is not None:
            error.filename = str(path)
        raise


def write_atomic(path: Path, data: bytes) -> None:
    """Write a file, or write over it.

    Raises:
        OSError: it cannot be written; what was there before still is.
    """
    with atomic_write(path) as part:
        part.write_bytes(data)
