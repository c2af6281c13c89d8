"""Report of a campaign: one page that stands alone, without a network."""

from collections.abc import Sequence
from html import escape
from pathlib import Path

from testbed.campaign import chart
from testbed.campaign.chart import Point, Whisker
from testbed.campaign.flight import failure_folder, replay_command
from testbed.campaign.grouping import best_front, heat_map
from testbed.campaign.result import Table
from testbed.campaign.row import OUTCOMES, Flown
from testbed.campaign.style import SCRIPT, STYLE
from testbed.campaign.summary import Quantity, Summary, spread, worst_runs
from testbed.campaign.sweep import Campaign

MOST_POINTS = 1500  # in one scatter; more are no clearer and make a page of megabytes
MOST_CASES = 40
ERRORS = ("shape_rms_m", "goal_rms_m", "track_rms_m", "final_error_m")


def html_report(
    campaign: Campaign, summary: Summary, runs: Sequence[Flown], table: Table, folder: Path
) -> str:
    """The page."""
    error = main_error(summary, table)
    sections = [
        _head(campaign, summary),
        _cases(summary),
        _medians(campaign, summary, runs),
        _distributions(summary, table),
        _influences(campaign, table, error),
        _maps(campaign, table, error),
        _front(table, error),
        _reasons(summary),
        _worst(campaign, runs, error, folder),
        _again(campaign, folder),
    ]
    title = escape(f"{campaign.file.name}: campaign report")
    return (
        f'<!doctype html>\n<html lang="en"><head><meta charset="utf-8"><title>{title}</title>'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<style>{STYLE}</style></head><body><main>{''.join(sections)}</main>"
        f"<script>{SCRIPT}</script></body></html>\n"
    )


def main_error(summary: Summary, table: Table) -> Quantity:
    """The error that the campaign is about: of the formation, if there is one, or to the goal."""
    known = {one.quantity.column: one.quantity for one in summary.spreads}
    names = [name for name in ERRORS if name in known]
    law_has_formation = any(value is not None for value in table.get("shape_rms_m", ()))
    if law_has_formation:
        return known["shape_rms_m"]
    return known[names[0]] if names else Quantity("duration_s", "flown", "s")


def titled(quantity: Quantity) -> str:
    """With its unit."""
    return f"{quantity.title} [{quantity.unit}]" if quantity.unit else quantity.title


def _head(campaign: Campaign, summary: Summary) -> str:
    low, high = (100.0 * end for end in summary.confidence_interval)
    rate = 100.0 * (summary.success_rate or 0.0)
    wanted = campaign.file.success
    poor = " poor" if wanted is not None and low < 100.0 * wanted else ""
    tiles = [
        f'<div class="tile main{poor}"><b>{rate:.1f} %</b><div class="meter">'
        f'<i style="left:{low:.2f}%;width:{high - low:.2f}%"></i>'
        f'<u style="left:calc({rate:.2f}% - 1.5px)"></u></div>'
        f"<span>passed; {100 * summary.confidence:g} % interval {low:.1f} to {high:.1f} %"
        + (f", wanted {100 * wanted:g} %" if wanted is not None else "")
        + "</span></div>"
    ]
    counts = [("runs", f"{summary.runs:,}".replace(",", "\N{THIN SPACE}"))]
    for outcome, words in OUTCOMES.items():
        if outcome != "passed" and outcome in summary.outcomes:
            counts.append((words, str(summary.outcomes[outcome])))
    for one in summary.spreads[:1]:
        unit = f" {one.quantity.unit}"
        counts.append((f"median {one.quantity.title}", f"{chart.number(one.median)}{unit}"))
        counts.append((f"worst, in run {one.worst_run}", f"{chart.number(one.worst)}{unit}"))
    tiles += [f'<div class="tile"><b>{b}</b><span>{escape(a)}</span></div>' for a, b in counts]
    said = escape(campaign.file.description)
    return (
        f"<h1>{escape(summary.campaign)}</h1>"
        f'<p class="soft">{said}{". " if said else ""}{summary.runs} of {summary.planned} runs of '
        f"{escape(summary.experiment)} on the twin; results of the twin, not of a table.</p>"
        f'<div class="tiles">{"".join(tiles)}</div>{_key()}'
    )


def _key() -> str:
    disc = '<svg viewBox="0 0 12 12"><circle class="good" cx="6" cy="6" r="4"/></svg>'
    cross = '<svg viewBox="0 0 12 12"><path class="bad-mark" d="M2.5 2.5l7 7m0 -7l-7 7"/></svg>'
    return (
        f'<p><span class="key">{disc}passed</span><span class="key">{cross}did not pass</span></p>'
    )


def _cases(summary: Summary) -> str:
    if not summary.cases:
        return ""
    rows = [
        Whisker(
            ", ".join(case.name.values()), case.rate.low, case.rate.rate or 0.0, case.rate.high,
            f"{case.rate.succeeded} of {case.rate.runs}",
        )
        for case in summary.cases[:MOST_CASES]
    ]  # fmt: skip
    more = len(summary.cases) - len(rows)
    note = f" The first {len(rows)} of {len(summary.cases)} are shown." if more else ""
    axes = escape(", ".join(summary.cases[0].name))
    return (
        f'<h2>Success by case</h2><p class="soft">{axes}. The bar is the interval.{note}</p>'
        f'<div class="charts"><figure>{chart.whiskers(rows)}</figure></div>'
    )


def _medians(campaign: Campaign, summary: Summary, runs: Sequence[Flown]) -> str:
    """Of each combination of the grid, what its runs had in the middle."""
    if not summary.cases:
        return ""
    by_point: dict[int, list[Flown]] = {}
    for run in sorted(runs, key=lambda run: run.k % campaign.combinations):
        by_point.setdefault(run.k % campaign.combinations, []).append(run)
    quantities = [one.quantity for one in summary.spreads]
    rows = []
    for point, flown in list(by_point.items())[:MOST_CASES]:
        parameters = campaign.parameters(point)
        name = ", ".join(str(parameters[axis.label]) for axis in campaign.file.grid)
        found = [spread(quantity, flown) for quantity in quantities]
        cells = "".join(
            f'<td class="n">{chart.number(one.median) if one else "-"}</td>' for one in found
        )
        rows.append(f"<tr><td>{escape(name)}</td>{cells}</tr>")
    heads = "".join(f'<th class="n">{escape(titled(quantity))}</th>' for quantity in quantities)
    return (
        '<h2>Numbers by case</h2><p class="soft">Median of the runs that have the number, whether '
        'they passed or not. The figures below are of all cases together.</p><div class="card">'
        f"<table><tr><th>case</th>{heads}</tr>{''.join(rows)}</table></div>"
    )


def _distributions(summary: Summary, table: Table) -> str:
    figures = []
    for one in summary.spreads:
        quantity = one.quantity
        pairs = zip(table[quantity.column], table["outcome"], strict=True)
        known = [(v * quantity.scale, o == "passed") for v, o in pairs if v is not None]
        good = [value for value, passed in known if passed]
        bad = [value for value, passed in known if not passed]
        few = "" if one.runs == summary.runs else f"{one.runs} of {summary.runs} runs: "
        words = (
            f"{few}median {chart.number(one.median)}, 95 % within {chart.number(one.p95)}, "
            f"worst {chart.number(one.worst)} in run {one.worst_run}"
        )
        picture = chart.histogram(good, bad, titled(quantity))
        figures.append(f"<figure>{picture}<figcaption>{words}</figcaption></figure>")
    if not figures:
        return ""
    return (
        '<h2>Distributions</h2><p class="soft">Of a run with several vehicles, the worst of them; '
        f'of what is used up, their sum.</p><div class="charts">{"".join(figures)}</div>'
    )


def points_of(table: Table, x: str, y: str, scales: tuple[float, float]) -> list[Point]:
    """One point per run that has both numbers."""
    return [
        Point(
            float(a) * scales[0], float(b) * scales[1], outcome == "passed",
            f"run {run}: {chart.number(a * scales[0])}, {chart.number(b * scales[1])}, {outcome}",
        )
        for run, a, b, outcome in zip(
            table["run"], table[x], table[y], table["outcome"], strict=True
        )
        if a is not None and b is not None
    ]  # fmt: skip


def thinned(points: list[Point]) -> list[Point]:
    """As many points as a picture shows; those that did not pass first."""
    if len(points) <= MOST_POINTS:
        return points
    bad = [point for point in points if not point.passed][:MOST_POINTS]
    good = [point for point in points if point.passed]
    stride = -(-len(good) // max(1, MOST_POINTS - len(bad)))
    return good[::stride] + bad


def numeric_parameters(campaign: Campaign, table: Table) -> list[str]:
    """Columns that were set or drawn, are numbers and differ."""
    names = [axis.label for axis in campaign.file.grid] + [d.label for d in campaign.file.draw]
    return [
        name
        for name in names
        if all(isinstance(v, int | float) and not isinstance(v, bool) for v in table.get(name, ()))
        and len(set(table.get(name, ()))) > 1
    ]


def _influences(campaign: Campaign, table: Table, error: Quantity) -> str:
    figures = []
    for name in numeric_parameters(campaign, table):
        points = points_of(table, name, error.column, (1.0, error.scale))
        if points:
            picture = chart.scatter(thinned(points), name, titled(error))
            figures.append(f"<figure>{picture}</figure>")
    if not figures:
        return ""
    return (
        '<h2>What it depends on</h2><p class="soft">Every parameter that was set or drawn.</p>'
        f'<div class="charts">{"".join(figures)}</div>'
    )


def _maps(campaign: Campaign, table: Table, error: Quantity) -> str:
    names = numeric_parameters(campaign, table)
    pairs = [(a, b) for i, a in enumerate(names) for b in names[i + 1 :]][:6]
    figures = []
    for a, b in pairs:
        for what in (None, error):
            picture = heat_map(table, a, b, what)
            if picture:
                words = "share that passed [%]" if what is None else f"median {titled(what)}"
                figures.append(
                    f"<figure>{picture}<figcaption>{escape(words)}</figcaption></figure>"
                )
    if not figures:
        return ""
    return f'<h2>Two at a time</h2><div class="charts">{"".join(figures)}</div>'


def _front(table: Table, error: Quantity) -> str:
    points = points_of(table, "gas_g", error.column, (1.0, error.scale)) if "gas_g" in table else []
    if len(points) < 2:
        return ""
    front = best_front(points)  # of all, also of those that the picture leaves out
    shown = list(dict.fromkeys([*thinned(points), *front]))
    picture = chart.scatter(shown, "gas [g]", titled(error), front)
    words = (
        "The line is the Pareto front of the runs that passed: no run has less error for less gas."
        if front
        else "No run passed: there is no Pareto front."
    )
    return (
        f'<h2>Error against gas</h2><p class="soft">{words}</p>'
        f'<div class="charts"><figure>{picture}</figure></div>'
    )


def _reasons(summary: Summary) -> str:
    if not summary.reasons:
        return ""
    rows = "".join(
        f'<tr><td class="n">{count}</td><td>{escape(reason)}</td></tr>'
        for reason, count in summary.reasons.items()
    )
    return (
        f'<h2>Why runs did not pass</h2><div class="card"><table><tr><th class="n">runs</th>'
        f"<th>reason</th></tr>{rows}</table></div>"
    )


def _worst(campaign: Campaign, runs: Sequence[Flown], error: Quantity, folder: Path) -> str:
    rows = []
    for run in worst_runs(runs, error):
        value = run.columns.get(error.column)
        words = "" if value is None else chart.number(float(value) * error.scale)
        reason = escape(run.reason.strip().splitlines()[-1][:160]) if run.reason else ""
        kept = failure_folder(folder, run.k)
        place = f"<br>folder: <code>{escape(str(kept))}</code>" if kept.exists() else ""
        command = escape(replay_command(campaign, folder, run.k))
        rows.append(
            f'<tr><td class="n">{run.k}</td><td class="{run.outcome}">{run.outcome}</td>'
            f'<td class="n">{words}</td><td>{reason}{place}</td>'
            f'<td class="wide"><code>{command}</code><button>copy</button></td></tr>'
        )
    return (
        '<h2>Look at these first</h2><p class="soft">The worst runs, and the command that flies '
        'each again, bit for bit.</p><div class="card"><table><tr><th class="n">run</th>'
        f'<th>ended</th><th class="n">{escape(titled(error))}</th><th>why</th><th>replay</th></tr>'
        f"{''.join(rows)}</table></div>"
    )


def _again(campaign: Campaign, folder: Path) -> str:
    place = escape(str(folder))
    return (
        "<h2>The same again</h2><p>Every number of every run is in "
        f"<code>{place}/results.parquet</code>; the file of the campaign is "
        f"<code>{place}/campaign.toml</code>. Seeds "
        f"{campaign.file.seed} to {campaign.file.seed + campaign.file.samples - 1}.</p>"
    )
