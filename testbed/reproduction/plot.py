"""Writes figures to files; the only module that imports matplotlib."""

from pathlib import Path

from matplotlib.figure import Figure as Sheet

from testbed.reproduction.figure import Figure

MOST = 12  # most curves in a legend


def draw(path: Path, title: str, figure: Figure) -> None:
    """Draw one figure to a PNG file."""
    sheet = Sheet(figsize=(7.0, 4.5), layout="constrained")
    axes = sheet.subplots()
    for name, (x, y) in figure.curves.items():
        axes.plot(x, y, label=name, linewidth=1.0)
        if figure.dots:
            axes.plot(x[-1:], y[-1:], "o", markersize=3.0, color="black")
    axes.set_xlabel(figure.x)
    axes.set_ylabel(figure.y)
    axes.set_title(f"{title}: {figure.name}", fontsize=10)
    axes.grid(visible=True, linewidth=0.3)
    if figure.dots:
        axes.set_aspect("equal", adjustable="datalim")
    if 1 < len(figure.curves) <= MOST:
        axes.legend(fontsize=7)
    sheet.savefig(path, dpi=110)
