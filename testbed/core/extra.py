"""The `pip` line for packages that only some verbs need."""

import shlex
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


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
