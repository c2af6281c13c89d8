"""The paper's numbers and a claim's limits, as items of a figure.

Only numbers that the paper prints are points: claims with a value, at the time of their measure.
"""

import re
from collections.abc import Iterator, Sequence

import numpy as np

from testbed.report.item import Item, Limit, Mark, Moment
from testbed.reproduction.claim import Claim, ClaimRow, limit_of
from testbed.reproduction.figure import Figure

SIGNS = {"equal": "", "at most": "\N{LESS-THAN OR EQUAL TO} ",
         "at least": "\N{GREATER-THAN OR EQUAL TO} "}  # fmt: skip
DIAMOND = 3  # shape of a paper's number, see SHAPES of testbed/report/chart.py


def limits(figure: Figure, claim: Claim, row: ClaimRow) -> Iterator[Item]:
    """The claim's limit and what was measured, if the figure has an axis for them."""
    axis = figure.axis_of(claim.measure or "")
    if not axis or claim.over is not None:
        return
    limit = limit_of(claim) + (claim.tolerance if figure.log and not limit_of(claim) else 0.0)
    named = (
        (limit, f"limit {SIGNS[claim.must]}{limit:.4g} {claim.unit}".rstrip(), ""),
        (row.measured, "" if row.measured is None else f"measured {row.measured:.4g}", "value"),
    )
    for value, name, style in named:
        if value is None or (figure.log and axis == "y" and value <= 0.0):
            continue
        yield Limit(value, name, style) if axis == "y" else Moment(value, name, style)


def points(figure: Figure, run: str, claims: Sequence[Claim]) -> list[Mark]:
    """The paper's numbers that belong to this figure of a run."""
    found = []
    for claim in claims:
        x = _place(figure, claim)
        if claim.run == run and claim.over is None and x is not None:
            text = f"{claim.source}: {claim.claim}, {claim.paper:g} {claim.unit}".rstrip()
            found.append(Mark(x, float(claim.paper), text, case=DIAMOND, style="paper", radius=5))
    return found


def _place(figure: Figure, claim: Claim) -> float | None:
    """Where on the x axis a claim's value stands; None if the paper gives no number or time."""
    measure = claim.measure or ""
    if figure.axis_of(measure) != "y" or isinstance(claim.paper, str) or claim.must != "equal":
        return None
    at = re.search(r" at (\d+)$", measure)
    if at:
        return float(at[1])
    if measure.startswith("final "):
        return max((float(np.max(x)) for x, _ in figure.curves.values() if len(x)), default=None)
    return None
