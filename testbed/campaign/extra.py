"""Optional packages that only some verbs need."""

from collections.abc import Iterator
from contextlib import contextmanager

from testbed.core.error import TestbedError
from testbed.core.extra import pip_install


class MissingExtraError(TestbedError):
    """A verb needs packages that are not installed."""


@contextmanager
def needs_extra(name: str) -> Iterator[None]:
    """Context for imports from the extra `name`.

    Raises:
        MissingExtraError: it is not installed; the message has the command to install it.
    """
    try:
        yield
    except ModuleNotFoundError as error:
        raise MissingExtraError(
            f"the package `{error.name}` is not installed\n"
            f"  expected  the extra `{name}`: {pip_install(name)}"
        ) from None
