"""Optional packages that only some verbs and calls need, and the `pip` line for them."""

import shlex
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from testbed.core.error import TestbedError

ROOT = Path(__file__).resolve().parents[2]


class MissingExtraError(TestbedError):
    """A verb or a call needs packages that are not installed."""


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
            where=f"the package `{error.name}` is not installed",
            expected=f"the extra `{name}`: {pip_install(name)}",
        ) from None


def pip_install(extra: str, root: Path = ROOT) -> str:
    """The command that installs an extra into the environment that runs this.

    In a checkout it installs the checkout, which may not be on any package index.
    """
    pip = shlex.quote(_short(Path(sys.executable).with_name("pip")))
    if not (root / "pyproject.toml").is_file():
        return f"{pip} install {shlex.quote(f'airbearing-testbed[{extra}]')}"
    pins = shlex.quote(_short(root / "constraints.txt"))
    return f"{pip} install -c {pins} -e {shlex.quote(f'{_short(root)}[{extra}]')}"


def _short(path: Path) -> str:
    """Path relative to the current folder, if it is inside it."""
    here = Path.cwd()
    return str(path.relative_to(here) if path.is_relative_to(here) else path)
