"""Installed packages, as an installer would leave them, without one."""

import tomllib
from pathlib import Path

EXAMPLES = Path(__file__).resolve().parents[1] / "examples" / "plugins"


def install(folder: Path, name: str, groups: dict[str, dict[str, str]]) -> None:
    """A distribution in a folder that is, or will be, on sys.path: its entry points by group."""
    about = folder / f"{name.replace('-', '_')}-1.0.dist-info"
    about.mkdir()
    (about / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n")
    lines = []
    for group, points in groups.items():
        lines += [f"[{group}]", *(f"{point} = {value}" for point, value in points.items())]
    (about / "entry_points.txt").write_text("\n".join(lines) + "\n")


def install_examples(folder: Path) -> None:
    """The package of examples/plugins, by its own pyproject.toml."""
    project = tomllib.loads((EXAMPLES / "pyproject.toml").read_text())["project"]
    install(folder, project["name"], project["entry-points"])
