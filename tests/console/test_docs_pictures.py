"""The pictures of docs/console.md: each state on three screens, light and dark, by pixel region."""

from pathlib import Path

import numpy as np
import pytest

Image = pytest.importorskip("PIL.Image")

FOLDER = Path(__file__).resolve().parents[2] / "docs" / "pictures"
GAP, LOW = 10, 420
WIDTHS = {"screen": 747, "tablet": 292, "phone": 195}  # 1366x768, 820x1180, 390x844, made LOW high
RED = (200, 24, 32)
SHEETS = sorted(path.stem for path in FOLDER.glob("sheet_*.png"))


def part(name: str, size: str, dark: bool) -> np.ndarray:
    """One page of a sheet, in pixels."""
    left = GAP
    for one, width in WIDTHS.items():
        if one == size:
            break
        left += width + GAP
    top = GAP + dark * (LOW + GAP)
    whole = np.asarray(Image.open(FOLDER / f"{name}.png").convert("RGB")).astype(int)
    return whole[top : top + LOW, left : left + WIDTHS[size] - 1]


def share(area: np.ndarray, colour: tuple[int, int, int]) -> float:
    return float(np.mean(np.abs(area - np.array(colour)).max(axis=-1) < 40))


def test_the_states_that_the_docs_name_are_there():
    page = (FOLDER.parent / "console.md").read_text()
    cases = ("arming", "one", "three", "five", "fault", "cameras", "hung")
    assert {f"sheet_{case}" for case in cases} == set(SHEETS)
    for name in SHEETS:
        assert f"pictures/{name}.png" in page, name
        assert (FOLDER / f"{name}.png").stat().st_size < 250_000


@pytest.mark.parametrize("dark", [False, True])
@pytest.mark.parametrize("size", WIDTHS)
@pytest.mark.parametrize("name", SHEETS)
def test_each_page_has_its_theme_and_its_button(name, size, dark):
    page = part(name, size, dark)
    middle = float(np.median(page))
    assert middle < 80 if dark else middle > 170
    button = page[-60:] if size == "phone" else page[:50, :120]
    assert share(button, RED) > 0.15


def whole(name: str) -> np.ndarray:
    return np.asarray(Image.open(FOLDER / f"{name}.png").convert("RGB")).astype(int)


@pytest.mark.parametrize(
    ("name", "is_red"), [("console_fault", True), ("console_hung", True), ("console_three", False)]
)
def test_trouble_is_a_red_line_across_the_page_and_a_flight_has_none(name, is_red):
    page = whole(name)
    assert page.shape[:2] == (768, 1366)
    line = page[90:115, 20:1340]  # below the button
    assert (share(line, (179, 21, 28)) > 0.4) == is_red


def test_a_hung_host_leaves_the_table_grey():
    def colour(name: str) -> float:  # of the table's part of the page
        table = whole(name)[170:720, 20:620]
        return float((table.max(axis=-1) - table.min(axis=-1)).mean())

    assert colour("console_hung") < 0.4 * colour("console_three")


@pytest.mark.parametrize("dark", [False, True])
def test_three_vehicles_have_three_colours(dark):
    table = part("sheet_three", "screen", dark)[60:, :355].reshape(-1, 3)
    hues = ((88, 166, 255), (255, 140, 70), (60, 200, 160)) if dark else (
        (0, 105, 180), (200, 84, 0), (0, 120, 95)
    )  # fmt: skip
    for hue in hues:
        assert int((np.abs(table - np.array(hue)).max(axis=-1) < 45).sum()) > 60, hue
