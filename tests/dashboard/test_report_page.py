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


@pytest.mark.slow
def test_on_a_phone_no_number_is_parted_from_its_unit(run, browser):
    with browser.Browser(360, 780) as page:
        page.open((run / "report.html").as_uri())
        page.value("new Promise(done => setTimeout(done, 300))")
        lines = page.value(
            "[...document.querySelectorAll('td.value')].map(cell => {"
            " const range = document.createRange(); range.selectNodeContents(cell);"
            " const rows = [...range.getClientRects()].map(r => Math.round(r.bottom / 8));"
            " return new Set(rows).size })"
        )
        assert len(lines) > 12  # the criteria, and the jets of each vehicle
        assert set(lines) == {1}


@pytest.mark.slow
def test_a_printed_report_keeps_its_verdict_and_colours(run, browser):
    with browser.Browser(1200, 900) as page:
        page.open((run / "report.html").as_uri())
        page.value("new Promise(done => setTimeout(done, 300))")
        page.call("Emulation.setEmulatedMedia", media="print")
        look = "(what, key) => getComputedStyle(document.querySelector(what))[key]"
        for what in (".verdict", ".dot", ".tile"):  # browsers leave out other backgrounds
            assert page.value(f"({look})('{what}', 'printColorAdjust')") == "exact"
        for what in (".cursor", ".values", "#scrub", ".on-screen"):
            assert page.value(f"({look})('{what}', 'display')") == "none"
