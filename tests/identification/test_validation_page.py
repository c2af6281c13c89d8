"""The page of `testbed validate`."""

from testbed.identification.validation_page import write_page


def test_every_column_has_a_heading(tmp_path):
    one = {
        "position_rms_m": 0.002, "position_median_m": 0.001, "heading_rms_deg": 0.1, "count": 9,
    }  # fmt: skip
    result = {
        "verdict": "good", "noise": {"position_m": 2e-4, "heading_deg": 0.03},
        "horizons": {1.0: {"vehicle": one, "against": one}},
    }  # fmt: skip
    write_page(tmp_path / "page.html", "Validation", result, {"vehicle": []})
    page = (tmp_path / "page.html").read_text()
    assert "<th>vehicle file</th>" in page
    assert "<th></th>" not in page
