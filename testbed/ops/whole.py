"""A file that is there whole or not at all: whoever looks for it never reads half of one."""

from pathlib import Path


def write_whole(path: Path, data: bytes) -> None:
    """Write a file, or write over it, in one step for everybody else.

    Raises:
        OSError: it cannot be written; what was there before still is.
    """
    part = path.with_name(path.name + ".part")
    part.write_bytes(data)
    part.replace(path)
