"""A report in a real browser, on a wide screen and on a narrow one, light and dark."""

from pathlib import Path

import pytest

from chromium import chromium

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def browser():
    return chromium()


@pytest.mark.slow
@pytest.mark.parametrize(("width", "dark"), [(1280, False), (420, True)])
def test_a_report_fits_its_window(run, browser, pictures, width, dark):
    with browser.Browser(width, 1000, dark=dark) as page:
        page.open((run / "report.html").as_uri())
        page.value("new Promise(done => setTimeout(done, 300))")
        assert page.value("document.readyState") in ("interactive", "complete")
        assert page.value("document.documentElement.scrollWidth") <= width
        boxes = page.value(
            "[...document.querySelectorAll('figure svg')].map(s => s.getBoundingClientRect().width)"
        )
        assert len(boxes) >= 12
        assert min(boxes) > 300.0
        smallest = page.value(
            "Math.min(...[...document.querySelectorAll('#error svg text')]"
            ".map(t => t.getBoundingClientRect().height))"
        )
        assert smallest > 8.0  # [pixels]: it can be read
        look = page.value("getComputedStyle(document.body).backgroundColor")
        assert look == ("rgb(18, 22, 28)" if dark else "rgb(255, 255, 255)")
        (pictures / f"report{width}.png").write_bytes(page.picture(whole=True))
