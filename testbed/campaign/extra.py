"""Packages that only some verbs need."""

from collections.abc import Iterator
from contextlib import contextmanager

from testbed.core.error import TestbedError
from testbed.core.extra import pip_install


class MissingExtraError(TestbedError):
    """A verb needs packages that are not installed."""


@contextmanager
def needs_extra(name: str) -> Iterator[None]:
    """Import what the extra `name` brings.

    Raises:
        MissingExtraError: it is not installed; says how to.
    """
    try:
        yield
    except ModuleNotFoundError as error:
        raise MissingExtraError(
            f"the package `{error.name}` is not installed\n"
            f"  expected  the extra `{name}`: {pip_install(name)}"
        ) from None
