"""A file is there whole or not at all, and a disk that is full says for which."""

from pathlib import Path

import pytest

from testbed.files import write_atomic


def test_a_full_disk_is_said_with_the_file_and_leaves_what_was_there(tmp_path):
    path = tmp_path / "summary.json"
    write_atomic(path, b"before")
    (tmp_path / "summary.json.part").symlink_to("/dev/full")
    with pytest.raises(OSError, match="No space left") as error:
        write_atomic(path, b"after")
    assert error.value.filename == str(path)
    assert path.read_bytes() == b"before"
    assert list(Path(tmp_path).iterdir()) == [path]
