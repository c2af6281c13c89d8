"""Words and numbers of report.html."""

import pytest

from testbed.report.page import _number, _pose, _three_digits, rounded

MINUS, JOINT = "\N{MINUS SIGN}", "\N{NO-BREAK SPACE}"


@pytest.mark.parametrize(
    ("value", "digits", "shown"),
    [(0.264, 2, "0.26"), (44.294, 2, "44.29"), (237.94, 2, "237.9"), (2432.73, 2, "2433"),
     (71.26, 1, "71.3"), (0.0291, 3, "0.029"), (1298.0, 0, "1298"), (-2432.73, 2, "-2433"),
     (0.0, 2, "0.00")],
)  # fmt: skip
def test_a_large_number_has_no_more_digits_than_it_is_worth(value, digits, shown):
    assert rounded(value, digits) == shown


def test_a_number_never_has_a_power_of_ten():
    assert [_three_digits(v) for v in (0.2184, 71.26, 2432.7)] == ["0.218", "71.3", "2433"]


def test_zero_has_no_minus():
    assert _number(-1e-9, 1.0, 2) == "0.00"
    assert _number(-0.01, 1.0, 2) == f"{MINUS}0.01"
    assert _pose((-1e-9, -2.2, -1e-9)) == f"(0.00, {MINUS}2.20){JOINT}m,{JOINT}0\N{DEGREE SIGN}"
