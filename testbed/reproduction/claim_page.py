"""The audit as web pages: an index, a page per paper, and a page per claim with its figures."""

from collections.abc import Iterator, Mapping, Sequence
from html import escape
from pathlib import Path
from typing import NamedTuple

import msgspec
import numpy as np

from testbed.report.axis import span, wants_log
from testbed.report.chart import thinned
from testbed.report.item import Box, Chart, Item, Mark, Moment
from testbed.report.page import SCRIPT, figure, page
from testbed.reproduction.claim import (
    CORRECTED,
    FAILS,
    HOLDS,
    UNTESTABLE,
    Claim,
    ClaimRow,
    Paper,
    Values,
    claimed,
    counts,
    limit_of,
    met,
    needed,
    values_of,
)
from testbed.reproduction.figure import Figure
from testbed.reproduction.paper_numbers import SIGNS, limits, points
from testbed.reproduction.plot import chart_of

LOOKS = {HOLDS: "passed", CORRECTED: "passed", FAILS: "fault", UNTESTABLE: "unjudged"}
AGAIN = "the same"  # begins a claim that refers to an earlier one
COLUMNS = 300  # of a curve on a page, which keeps it small
STYLE = """nav { display: flex; gap: 18px; margin-bottom: 18px; } td { vertical-align: top; }
.badge { color: #fff; border-radius: 6px; padding: 1px 8px; font-size: 13px; white-space: nowrap; }
figure:has(rect.table) { grid-row: span 2; }
td.fact { white-space: normal; text-align: left; max-width: 75ch; } a { color: var(--h0); }"""


class Audited(NamedTuple):
    """A paper with its verdicts, and what its runs gave."""

    paper: Paper
    rows: Sequence[ClaimRow]
    values: Mapping[str, Values]  # by run
    figures: Mapping[str, Sequence[Figure]]  # by run


def write_pages(folder: Path, audit: Mapping[str, Audited]) -> Path:
    """Write all pages; returns the index."""
    index = folder / "index.html"
    index.write_text(_index(audit), encoding="utf-8")
    for key, one in audit.items():
        (folder / f"{key}.html").write_text(_of_paper(key, one), encoding="utf-8")
        claims, title = {f"{key}.{claim.id}": claim for claim in one.paper.claims}, ""
        for k, row in enumerate(one.rows):
            near = [one.rows[n].id for n in (k - 1, k + 1) if 0 <= n < len(one.rows)]
            again = row.claim.startswith(AGAIN)
            title = title if again else row.claim
            words = f"{title}: {row.claim}" if again else row.claim
            text = _of_claim(key, one, claims[row.id], row, near, words)
            (folder / f"{row.id}.html").write_text(text, encoding="utf-8")
    return index


def _badge(outcome: str) -> str:
    return f'<span class="badge {LOOKS[outcome]}">{escape(outcome)}</span>'


def _index(audit: Mapping[str, Audited]) -> str:
    rows = "".join(
        f'<tr><td><a href="{key}.html">{key}</a></td>'
        f'<td class="fact">{escape(one.paper.title)}</td>'
        + "".join(f"<td>{n}</td>" for n in counts(one.rows).claims.values())
        + "</tr>"
        for key, one in audit.items()
    )
    heads = "".join(f"<th>{_badge(one)}</th>" for one in LOOKS)
    every = counts([row for one in audit.values() for row in one.rows])
    body = (
        "<header><div><h1>Which claims of the papers hold</h1>"
        f'<p class="soft">{escape(str(every))}. The papers\' simulations were flown again with '
        "their own parameters; each claim has a page with its limits, the measured values and the "
        f'figures.</p></div></header><div class="wide"><table><tr><th>paper</th><th></th>{heads}'
        f"</tr>{rows}</table></div>"
    )
    return page("Claims of the papers", body, STYLE)


def _of_paper(key: str, one: Audited) -> str:
    rows = "".join(
        f'<tr><td><a href="{row.id}.html">{escape(row.id.partition(".")[2])}</a></td>'
        f'<td class="fact">{escape(row.source)}</td><td class="fact">{escape(row.claim)}</td>'
        f'<td class="fact">{escape(claimed(row))}</td><td>{_measured(row)}</td>'
        f"<td>{_badge(row.outcome)}</td></tr>"
        for row in one.rows
    )
    body = (
        f'<nav><a href="index.html">all papers</a></nav><header><div><h1>{key}: '
        f'{escape(one.paper.title)}</h1><p class="soft">{escape(one.paper.source)}</p>'
        f"<p>{escape(one.paper.remark.strip())}</p><p>{escape(str(counts(one.rows)))}.</p></div>"
        '</header><div class="wide"><table><tr><th>claim</th><th class="words">where</th>'
        '<th class="words">what</th><th class="words">paper</th><th>measured</th><th>verdict</th>'
        f"</tr>{rows}</table></div>"
    )
    return page(f"{key}: claims", body, STYLE)


def _measured(row: ClaimRow) -> str:
    if row.measured is None:
        return "\N{EN DASH}" if row.outcome == UNTESTABLE else "never"
    return escape(f"{row.measured:.4g} {row.unit}".strip())


def _of_claim(
    key: str, one: Audited, claim: Claim, row: ClaimRow, near: Sequence[str], title: str
) -> str:
    links = "".join(f'<a href="{other}.html">{escape(other)}</a>' for other in near)
    body = (
        f'<nav><a href="index.html">all papers</a><a href="{key}.html">{key}</a>{links}</nav>'
        f"<header><div><h1>{escape(title)}</h1>"
        f'<p class="soft">{escape(row.id)} &middot; {escape(row.source)} of {key}</p></div>'
        f'<div class="verdict {LOOKS[row.outcome]}">{escape(row.outcome)}</div></header>'
        f'<div class="wide"><table>{"".join(_facts(key, claim, row))}</table></div>'
    )
    if claim.untestable is None:
        gauge = _gauge(claim, row, values_of(key, claim, one.values))
        drawn = "".join(map(figure, [gauge, *_charts(one, claim, row)]))
        body += f'<h2>Measured, and the figures of the runs</h2><div class="figures">{drawn}</div>'
        read = "".join(_readings(one.paper, claim))
        table = f'<div class="wide"><table>{read}</table></div>'
        body += f"<h2>How the print is read</h2>{table}" * bool(read)
    return page(row.id, body, STYLE, SCRIPT)


def _line(name: str, words: str) -> str:
    return f'<tr><td>{name}</td><td class="fact">{words}</td></tr>'


def _facts(key: str, claim: Claim, row: ClaimRow) -> Iterator[str]:
    text = claimed(row).replace("<= ", SIGNS["at most"]).replace(">= ", SIGNS["at least"])
    yield _line("the paper", escape(text))
    if claim.untestable is not None:
        yield _line("cannot be tested", escape(claim.untestable))
        return
    limit = f"{SIGNS[claim.must]}{limit_of(claim):.6g} {claim.unit}".rstrip()
    slack = f", tolerance {claim.tolerance:g} {claim.unit}".rstrip() if claim.tolerance else ""
    if limit + slack != text:
        yield _line("limit", escape(limit + slack))
    seeds = f"the worst of {row.seeds} seeds" if row.seeds > 1 else "one run"
    quick = ", quick: fewer seeds, coarser steps" * row.quick
    yield _line("measured", f"<b>{_measured(row)}</b> ({seeds}{quick})")
    over = f", divided by that of <code>{escape(claim.over)}</code>" if claim.over else ""
    run = f"run <code>{escape(str(claim.run))}</code>{over}, configs/papers/{key}.toml"
    yield _line("from", f"<code>{escape(str(claim.measure))}</code> of {run}; "
                f"<code>testbed reproduce {key}</code>")  # fmt: skip
    if row.note:
        yield _line("note", escape(row.note))


def _readings(paper: Paper, claim: Claim) -> Iterator[str]:
    """Corrections of the print and assumptions that the verdict depends on."""
    runs = [paper.runs[name] for name in needed(claim)]
    for name in dict.fromkeys([*(n for r in runs for n in r.corrections), *claim.corrections]):
        fix = paper.corrections[name]
        words = f"{fix.at}: printed {fix.printed}; read as {fix.read}. {fix.why}"
        yield _line("correction", escape(words))
    for name in dict.fromkeys([*(n for r in runs for n in r.assumptions), *claim.assumptions]):
        guess = paper.assumptions[name]
        yield _line("assumption", escape(f"{guess.what}. {guess.why}"))


def _gauge(claim: Claim, row: ClaimRow, values: Sequence[float | None]) -> Chart:
    """The measured values on a line, with the values that satisfy the claim shaded."""
    limit = limit_of(claim)
    low, high = limit - claim.tolerance, limit + claim.tolerance
    seen = [float(v) for v in values if v is not None and np.isfinite(v)]
    every = [*seen, limit, *((low, high) if claim.must == "equal" else ())]
    log = wants_log(every)
    left, right = span(every, log, room=0.15)
    if left < 0.0 <= min(every):
        left = 0.0
    zone = {"equal": (low, high), "at most": (left, high), "at least": (low, right)}[claim.must]
    items: list[Item] = [
        Box((max(zone[0], left), min(zone[1], right)), (0.0, 1.0), "zone", "satisfies the claim"),
        Moment(limit, f"limit {SIGNS[claim.must]}{limit:.6g}"),
    ]
    for k, value in enumerate(seen):
        place = 0.5 if len(seen) == 1 else 0.25 + 0.35 * k / (len(seen) - 1)
        items.append(Mark(value, place, f"{value:.6g}", met(claim, value), radius=7))
    if not seen:
        never = "Not measured: it never happens in the run."
    else:
        never = "Shaded: satisfies the claim. Disc: measured, and met; cross: not met."
    name = f"{claim.measure}, over that of {claim.over}" if claim.over else str(claim.measure)
    unit = f"{name} [{claim.unit}]" if claim.unit else name
    return Chart("gauge", "Measured value and limit", unit, "", items, (left, right), (0.0, 1.0),
                 x_log=log, y_ticks=(), height=90, note=never)  # fmt: skip


def _charts(one: Audited, claim: Claim, row: ClaimRow) -> Iterator[Chart]:
    """Figures that show the claim's measure, in each run that it needs."""
    for run in needed(claim):
        for k, drawn in enumerate(one.figures.get(run, ())):
            if drawn.axis_of(str(claim.measure)) is None and not (drawn.dots and drawn.circles):
                continue
            marks = points(drawn, run, one.paper.claims)
            sources = ", ".join(dict.fromkeys(c.source for c in one.paper.claims if c.run == run
                                              and points(drawn, run, [c])))  # fmt: skip
            note = f"Black diamonds: the paper's numbers ({sources})." if marks else ""
            small = msgspec.structs.replace(drawn, curves={
                name: thinned(np.asarray(x), np.asarray(y), COLUMNS)
                for name, (x, y) in drawn.curves.items()
            }) if not drawn.dots else drawn  # fmt: skip
            more = [*limits(drawn, claim, row), *marks]
            yield chart_of(f"{run}_{k}", run, small, more, note)
