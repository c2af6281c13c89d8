"""Atomic file writing: a reader never sees a half-written file."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def atomic_write(path: Path) -> Iterator[Path]:
    """Yield a temporary path; it replaces `path` in one step when the block ends."""
    part = path.with_name(path.name + ".part")
    try:
        with named(path):
            yield part
        part.replace(path)
    finally:
        part.unlink(missing_ok=True)


@contextmanager
def named(path: Path) -> Iterator[None]:
    """Add the path to an OSError that has none, such as a full disk."""
    try:
        yield
    except OSError as error:
        if error.filename is None and error.errno is not None:
            error.filename = str(path)
        raise


def write_atomic(path: Path, data: bytes) -> None:
    """Write or overwrite a file.

    Raises:
        OSError: it cannot be written; the old content is kept.
    """
    with atomic_write(path) as part:
        part.write_bytes(data)
