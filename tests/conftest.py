"""What holds for all tests."""

import tempfile

import pytest


@pytest.fixture(scope="session", autouse=True)
def own_notes():
    """Keep the notes of flights out of the user's folder, where `testbed stop` would find them.

    A host that a test kills leaves its note. The folder's path is short: sockets lie in it.
    """
    with (
        tempfile.TemporaryDirectory(prefix="testbed-") as folder,
        pytest.MonkeyPatch.context() as patch,
    ):
        patch.setenv("XDG_RUNTIME_DIR", folder)
        yield
