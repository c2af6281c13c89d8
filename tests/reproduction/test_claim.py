"""A claim against a number: the comparison, the worst of the seeds, the words of the verdict."""

import math

import msgspec
import numpy as np
import pytest

from testbed.reproduction.claim import (
    CHECK,
    CORRECTED,
    FAILS,
    HOLDS,
    UNTESTABLE,
    Assumption,
    Claim,
    Correction,
    MeasureError,
    Paper,
    claimed,
    counts,
    judge,
    met,
    worst,
)
from testbed.reproduction.layout import Layouts

FIX = Correction("Eq. (1)", "a plus", "a minus", "the sum is wrong otherwise")
GUESS = Assumption("m = 10 kg", "not printed")


def claim(**changes) -> Claim:
    numbers = {"id": "x", "source": "Fig. 1", "claim": "it is so", "paper": 10.0, "unit": "m",
               "run": "plain", "measure": "gap"}  # fmt: skip
    return Claim(**(numbers | changes))


def paper(*claims: Claim) -> Paper:
    runs = {
        "plain": Layouts(),
        "fixed": Layouts(corrections=("sign",), assumptions=("mass",)),
    }
    return Paper("title", "source", "remark", {"sign": FIX}, {"mass": GUESS}, runs, claims)


def row(one: Claim, *values: float | None, other: float | None = None):
    made = {"plain": {"gap": list(values)}, "fixed": {"gap": [other]}}
    return judge("key", paper(one), one, made, quick=False)


@pytest.mark.parametrize(
    ("must", "tolerance", "value", "outcome"),
    [
        ("equal", 0.0, 10.0, HOLDS),
        ("equal", 0.5, 10.5, HOLDS),
        ("equal", 0.5, 9.5, HOLDS),
        ("equal", 0.5, math.nextafter(10.5, 11.0), FAILS),
        ("at most", 0.0, 10.0, HOLDS),
        ("at most", 0.0, math.nextafter(10.0, 11.0), FAILS),
        ("at most", 1.0, 11.0, HOLDS),
        ("at least", 0.0, 10.0, HOLDS),
        ("at least", 0.0, math.nextafter(10.0, 9.0), FAILS),
        ("at least", 1.0, 9.0, HOLDS),
        ("at most", 0.0, None, FAILS),
        ("at most", 0.0, math.nan, FAILS),
    ],
)
def test_outcome_is_measured(must, tolerance, value, outcome):
    found = row(claim(must=must, tolerance=tolerance), value)
    assert found.outcome == outcome
    assert found.verdict.startswith("reproduced" if outcome == HOLDS else "not reproducible: ")


@pytest.mark.parametrize(("must", "value"), [("at most", 12.0), ("at least", 7.0), ("equal", 7.0)])
def test_the_worst_seed_counts(must, value):
    assert worst(claim(must=must), [9.0, 12.0, 7.0]) == value


def test_a_seed_without_a_value_is_the_worst():
    assert worst(claim(must="at most"), [1.0, None]) is None
    assert not met(claim(must="at most"), None)


def test_words_need_a_limit():
    with pytest.raises(ValueError, match="expected a `limit`, because `paper` is text"):
        claim(paper="small")
    assert row(claim(paper="small", must="at most", limit=3.0), 2.0).outcome == HOLDS


def test_what_holds_with_a_correction_says_which():
    found = judge(
        "key", paper(claim(run="fixed")), claim(run="fixed"), {"fixed": {"gap": [10.0]}}, quick=True
    )
    assert found.outcome == CORRECTED
    assert found.assumption == "Eq. (1) read as a minus; m = 10 kg"
    assert found.verdict == f"reproduced with assumption: {found.assumption}"
    assert found.quick


def test_a_ratio_of_two_runs():
    one = claim(over="fixed", paper=2.0)
    assert row(one, 10.0, other=5.0).outcome == CORRECTED
    assert row(one, 10.0, other=4.0).outcome == FAILS
    assert row(one, 10.0, other=0.0).outcome == FAILS  # there is no ratio


def test_what_cannot_be_tested_says_why():
    found = row(claim(run=None, measure=None, paper="curves", untestable="no data"), 1.0)
    assert found.outcome == UNTESTABLE
    assert found.verdict == "not reproducible: no data"
    assert found.measured is None


def test_an_outcome_that_is_not_the_expected_one_is_seen():
    assert row(claim(), 10.0).as_expected
    assert not row(claim(), 11.0).as_expected
    assert row(claim(expected=FAILS), 11.0).as_expected


def test_a_measure_that_the_run_does_not_have():
    with pytest.raises(MeasureError, match=r"key\.x: expected a measure of run plain: gap; found"):
        row(claim(measure="length"), 1.0)


@pytest.mark.parametrize(
    ("claims", "complaint"),
    [
        ((claim(), claim()), "expected every claim once, found x twice"),
        ((claim(run="nowhere"),), "expected a run of plain, fixed, found nowhere in x"),
        ((claim(over="nowhere"),), "found nowhere in x"),
        ((claim(corrections=("no",)),), "expected a known correction in x, found no"),
        ((claim(assumptions=("no",)),), "expected a known assumption in x, found no"),
    ],
)
def test_a_paper_that_does_not_fit_together_is_refused(claims, complaint):
    with pytest.raises(ValueError, match=complaint):
        paper(*claims)


def test_a_claim_needs_a_run_or_a_reason():
    text = {"id": "x", "source": "s", "claim": "c", "paper": 1.0, "unit": "m"}
    with pytest.raises(msgspec.ValidationError, match="expected a run and a measure, or a reason"):
        msgspec.convert(text, Claim)


def test_numbers_of_numpy_can_be_written_as_json():
    found = row(claim(), np.float64(10.0))
    assert type(found.measured) is float
    assert msgspec.json.decode(msgspec.json.encode(found))["measured"] == 10.0


def test_an_input_check_is_no_claim_of_the_paper():
    check = claim(kind=CHECK, run="fixed", corrections=("sign",))
    passed = judge("key", paper(check), check, {"fixed": {"gap": [10.0]}}, quick=False)
    assert (passed.outcome, passed.verdict) == (HOLDS, "input check passed")
    failed = judge("key", paper(check), check, {"fixed": {"gap": [11.0]}}, quick=False)
    assert (failed.outcome, failed.verdict) == (FAILS, "input check failed")
    found = counts([passed, failed, row(claim(), 10.0), row(claim(), 11.0), row(claim(), 12.0)])
    assert found.claims == {HOLDS: 1, CORRECTED: 0, FAILS: 2, UNTESTABLE: 0}
    assert found.input_checks == {"passed": 1, "failed": 1}
    assert str(found) == (
        "3 claims: 1 holds, 0 holds with a correction, 2 fails, 0 cannot be tested; "
        "2 input checks, 1 of them failed"
    )
    assert str(counts([passed])).endswith("; 1 input checks, all passed")
    assert "input" not in str(counts([row(claim(), 10.0)]))


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({}, "10 m"),
        ({"tolerance": 0.5}, "10 m (+- 0.5)"),
        ({"must": "at most"}, "<= 10 m"),
        ({"paper": "small", "must": "at most", "limit": 3.0}, "small (<= 3 m)"),
        ({"paper": "3/4", "limit": 0.75, "tolerance": 0.1, "unit": ""}, "3/4 (0.75 (+- 0.1))"),
        ({"paper": "> 1", "must": "at least", "limit": 1.0}, "> 1"),
        ({"paper": "< 1", "must": "at most", "limit": 0.9, "unit": ""}, "< 1 (<= 0.9)"),
        ({"paper": "< a lot", "must": "at most", "limit": 9.0}, "< a lot (<= 9 m)"),
        ({"paper": "curves", "run": None, "measure": None, "untestable": "no data"}, "curves"),
    ],
)
def test_what_is_claimed_is_said_with_the_limit_that_decides(changes, said):
    assert claimed(row(claim(**changes), 10.0)) == said
