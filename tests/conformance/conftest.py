"""The examples as an installed package."""

import pytest

from distribution import install_examples


@pytest.fixture
def installed(tmp_path_factory, monkeypatch):
    """The folder that the package is installed in."""
    folder = tmp_path_factory.mktemp("installed")
    install_examples(folder)
    monkeypatch.syspath_prepend(folder)
    return folder
