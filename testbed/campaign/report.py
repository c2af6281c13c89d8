"""Report of a campaign: one self-contained HTML page."""

from collections.abc import Sequence
from html import escape
from pathlib import Path

from testbed.campaign.figures import (
    HOLLOW,
    RateRow,
    Strip,
    heat,
    histogram,
    scatter,
    strips,
    success_rates,
)
from testbed.campaign.flight import failure_folder, replay_command
from testbed.campaign.grouping import best_front, fields, points_of, thinned
from testbed.campaign.result import Table
from testbed.campaign.row import OUTCOMES, FlownRun
from testbed.campaign.summary import (
    Group,
    Groups,
    Quantity,
    Summary,
    by_axes,
    groups,
    groups_by,
    in_field,
    main_error,
    named_axes,
    numeric_parameters,
    spread,
    worst_runs,
)
from testbed.campaign.sweep import Campaign
from testbed.report.axis import number
from testbed.report.chart import draw, mark
from testbed.report.item import Box, Mark
from testbed.report.page import page

STYLE = Path(__file__).with_name("campaign.css").read_text(encoding="utf-8")
SCRIPT = Path(__file__).with_name("campaign.js").read_text(encoding="utf-8")

MOST_CASES = 40
MOST_MAPS = 18  # heat maps of one quantity; at most six pairs of parameters


def html_report(
    campaign: Campaign, summary: Summary, runs: Sequence[FlownRun], table: Table, folder: Path
) -> str:
    """The campaign's report as one HTML page."""
    error = main_error(summary, table)
    apart = groups(campaign, runs)
    sections = [
        _head(campaign, summary, apart),
        _cases(summary, apart),
        _medians(campaign, summary, runs, apart),
        _distributions(summary, table, apart),
        _influences(campaign, table, error, apart),
        _maps(campaign, runs, table, error, apart),
        _front(table, error, apart),
        _reasons(summary),
        _worst(campaign, runs, error, folder),
        _again(campaign, folder),
    ]
    body = f"{''.join(sections)}<script>{SCRIPT}</script>"
    return page(f"{campaign.file.name}: campaign report", body, STYLE)


def _head(campaign: Campaign, summary: Summary, apart: Groups) -> str:
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
        counts.append(_median(one.quantity, one.median, apart))
        counts.append((f"worst, in run {one.worst_run}", f"{number(one.worst)}{unit}"))
    tiles += [f'<div class="tile"><b>{b}</b><span>{escape(a)}</span></div>' for a, b in counts]
    description = escape(campaign.file.description)
    sentence = f"{description}. " if description else ""
    return (
        f"<h1>{escape(summary.campaign)}</h1>"
        f'<p class="soft">{sentence}{summary.runs} of {summary.planned} runs of '
        f"{escape(summary.experiment)} on the twin; results of the twin, not of a table.</p>"
        f'<div class="tiles">{"".join(tiles)}</div>{_key(apart)}'
    )


def _median(quantity: Quantity, of_all: float, apart: Groups) -> tuple[str, str]:
    """Title and number of a tile; for several cases, the smallest and the largest median."""
    found = [(one.median, g.name) for g in apart.shown if (one := spread(quantity, g.runs))]
    if not found:
        return f"median {quantity.title}", f"{number(of_all)} {quantity.unit}"
    (low, least), (high, most) = min(found), max(found)
    words = f"median {quantity.title}: least with {least}, most with {most}"
    words += "." * bool(apart.rest) + apart.rest
    return words, f"{number(low)} to {number(high)} {quantity.unit}"


def _key(apart: Groups) -> str:
    keys = [(swatch(k), group.name) for k, group in enumerate(apart.shown)]
    if keys:
        keys.append((swatch(None, '<circle class="hollow" cx="6" cy="6" r="4"/>'), HOLLOW))
    else:
        keys = [
            (swatch(None, mark(Mark(0, 0, passed=passed, radius=4), 6, 6)), words)
            for passed, words in ((True, "passed"), (False, "did not pass"))
        ]
    spans = "".join(f'<span class="key">{one}{escape(words)}</span>' for one, words in keys)
    of = f'<span class="key">{escape(", ".join(apart.axes))}:</span>' if apart.shown else ""
    return f"<p>{of}{spans}</p>"


def swatch(case: int | None, drawn: str = "") -> str:
    """The mark of a case beside its name; empty if it has none."""
    if case is not None:
        drawn = mark(Mark(0, 0, case=case, style="full", radius=4), 6, 6)
    return f'<svg class="swatch" viewBox="0 0 12 12">{drawn}</svg>' if drawn else ""


def _cases(summary: Summary, apart: Groups) -> str:
    if not summary.cases:
        return ""
    rows = [
        RateRow(
            ", ".join(case.name.values()), case.rate.low, case.rate.rate or 0.0, case.rate.high,
            f"{case.rate.succeeded} of {case.rate.runs}",
            apart.place(apart.name_of(case.name)),
        )
        for case in summary.cases[:MOST_CASES]
    ]  # fmt: skip
    more = len(summary.cases) - len(rows)
    note = f" The first {len(rows)} of {len(summary.cases)} are shown." if more else ""
    axes = escape(", ".join(summary.cases[0].name))
    return (
        f'<h2>Success by case</h2><p class="soft">{axes}. Bars are confidence intervals.{note}</p>'
        f'<div class="charts"><figure>{draw(success_rates(rows))}</figure></div>'
    )


def _medians(campaign: Campaign, summary: Summary, runs: Sequence[FlownRun], apart: Groups) -> str:
    """Medians for each combination of the grid."""
    if not summary.cases:
        return ""
    axes = [axis.label for axis in campaign.file.grid]
    quantities = [one.quantity for one in summary.spreads]
    rows = []
    for point, flown in list(by_axes(campaign, runs, axes).items())[:MOST_CASES]:
        name = dict(zip(axes, point, strict=True))
        dot = swatch(apart.place(apart.name_of(name)))
        found = [spread(quantity, flown) for quantity in quantities]
        cells = "".join(f'<td class="n">{number(one.median) if one else "-"}</td>' for one in found)
        rows.append(f'<tr><td class="name">{dot}{escape(", ".join(point))}</td>{cells}</tr>')
    heads = "".join(f'<th class="n">{escape(quantity.titled)}</th>' for quantity in quantities)
    return (
        '<h2>Numbers by case</h2><p class="soft">Median of the runs that have the number, whether '
        f'they passed or not. {escape(apart.sentence(campaign.combinations))}</p><div class="wide">'
        f"<table><tr><th>{escape(', '.join(axes))}</th>{heads}</tr>{''.join(rows)}</table></div>"
    )


def _distributions(summary: Summary, table: Table, apart: Groups) -> str:
    figures = []
    for one in summary.spreads:
        quantity = one.quantity
        if apart.shown:
            rows = [_strip(quantity, group) for group in apart.shown]
            if any(row.median is not None for row in rows):
                words = f"The line is the median. The worst is in run {one.worst_run}: "
                words += f"{number(one.worst)} {quantity.unit}".strip()
                picture = draw(strips(rows, quantity.titled))
                figures.append(f"<figure>{picture}<figcaption>{words}</figcaption></figure>")
            continue
        pairs = zip(table[quantity.column], table["outcome"], strict=True)
        known = [(v * quantity.scale, o == "passed") for v, o in pairs if v is not None]
        good = [value for value, passed in known if passed]
        bad = [value for value, passed in known if not passed]
        few = "" if one.runs == summary.runs else f"{one.runs} of {summary.runs} runs: "
        words = (
            f"{few}median {number(one.median)}, 95 % within {number(one.p95)}, "
            f"worst {number(one.worst)} in run {one.worst_run}"
        )
        picture = draw(histogram(good, bad, quantity.titled))
        figures.append(f"<figure>{picture}<figcaption>{words}</figcaption></figure>")
    if not figures:
        return ""
    return (
        '<h2>Distributions</h2><p class="soft">For several vehicles, the worst of them; '
        f"consumption is their sum.{apart.rest}</p>"
        f'<div class="charts">{"".join(figures)}</div>'
    )


def _strip(quantity: Quantity, group: Group) -> Strip:
    one = spread(quantity, group.runs)
    if one is None:
        return Strip(group.name, [], [], None, "no run has it")
    few = one.runs < len(group.runs)
    rest = f"{one.runs} of {len(group.runs)} runs" if few else f"95 % within {number(one.p95)}"
    words = f"median {number(one.median)}, {rest}"
    pairs = [(run.columns.get(quantity.column), run.outcome == "passed") for run in group.runs]
    good = [value * quantity.scale for value, passed in pairs if value is not None and passed]
    bad = [value * quantity.scale for value, passed in pairs if value is not None and not passed]
    return Strip(group.name, good, bad, one.median, words)


def _influences(campaign: Campaign, table: Table, error: Quantity, apart: Groups) -> str:
    figures, names = [], [group.name for group in apart.shown]
    for name in numeric_parameters(campaign, table):
        points = points_of(table, name, error.column, (1.0, error.scale), apart)
        if points:
            picture = draw(scatter(thinned(points), name, error.titled, names=names))
            figures.append(f"<figure>{picture}</figure>")
    if not figures:
        return ""
    return (
        '<h2>What it depends on</h2><p class="soft">Every parameter that was set or drawn.'
        f'{apart.rest}</p><div class="charts">{"".join(figures)}</div>'
    )


def _maps(
    campaign: Campaign, runs: Sequence[FlownRun], table: Table, error: Quantity, groups: Groups
) -> str:
    """Heat maps over pairs of numeric parameters; one panel per non-numeric case."""
    names = numeric_parameters(campaign, table)
    apart = groups_by(campaign, runs, named_axes(campaign))
    panels = apart.shown or [Group("", list(runs))]
    every = [(a, b) for i, a in enumerate(names) for b in names[i + 1 :]]
    pairs = every[: min(6, MOST_MAPS // len(panels))]
    rows = []
    for a, b in pairs:
        for what in (None, error):
            words = "passed [%]" if what is None else f"median {what.titled}"
            figures = [
                f"<figure>{picture}<figcaption>{swatch(groups.place(panel.name))}"
                f"{escape(': '.join(filter(None, (panel.name, words))))}</figcaption></figure>"
                for panel, picture in zip(panels, heat_maps(table, a, b, what, panels), strict=True)
                if picture
            ]
            rows += ["".join(figures)] if figures else []
    if not rows:
        return ""
    if not apart.shown:
        return f'<h2>Two at a time</h2><div class="charts">{"".join(rows)}</div>'
    cut = f" The first {len(pairs)} of {len(every)} pairs." if len(pairs) < len(every) else ""
    words = f"For each {' and '.join(apart.axes)}; all maps of a row share one scale."
    return f'<h2>Two at a time</h2><p class="soft">{escape(words)}{cut}{apart.rest}</p>' + "".join(
        f'<div class="charts">{row}</div>' for row in rows
    )


def heat_maps(
    table: Table, a: str, b: str, what: Quantity | None, panels: Sequence[Group]
) -> list[str]:
    """Success rate, or a number's median, over two parameters; empty without data.

    All panels have the same fields and the same scale.
    """
    columns, column_names = fields(table[a])
    rows, row_names = fields(table[b])
    spots = dict(zip(table["run"], zip(columns, rows, strict=True), strict=True))
    found: list[dict[tuple[int, int], tuple[float, int]]] = []
    for panel in panels:
        flown: dict[tuple[int, int], list[FlownRun]] = {}
        for run in sorted(panel.runs, key=lambda run: run.k):
            flown.setdefault(spots[run.k], []).append(run)
        found.append({spot: one for spot, met in flown.items() if (one := in_field(met, what))})
    values = [value for fields_of in found for value, _ in fields_of.values()]
    low, high = (min(values, default=0.0), max(values, default=0.0)) if what else (0.0, 100.0)
    return [
        draw(heat(
            [
                Box(
                    (column, column + 1), (row, row + 1), "heat",
                    f"{a} {column_names[column]}, {b} {row_names[row]}: {value:.4g} ({count} runs)",
                    words=f"{value:.3g}",
                    share=(value - low) / (high - low) if high > low else 0.5,
                )
                for (column, row), (value, count) in fields_of.items()
            ],
            column_names, row_names, a, b,
        )) if fields_of else ""
        for fields_of in found
    ]  # fmt: skip


def _front(table: Table, error: Quantity, apart: Groups) -> str:
    points = points_of(table, "gas_g", error.column, (1.0, error.scale), apart)
    if len(points) < 2:
        return ""
    names = [group.name for group in apart.shown]
    every = [
        best_front([point for point in points if point.case == case])  # also of undrawn points
        for case in (range(len(names)) if names else (None,))
    ]
    fronts = [front for front in every if front]
    shown = list(dict.fromkeys([*thinned(points), *(p for front in fronts for p in front)]))
    picture = draw(scatter(shown, "gas [g]", error.titled, fronts, names))
    words = "No run passed: there is no Pareto front."
    if fronts and names:
        none = [name for name, front in zip(names, every, strict=True) if not front]
        words = "Each line is the Pareto front of the passed runs of one colour: no other run has "
        words += "both less error and less gas."
        words += f" No run passed of: {escape(', '.join(none))}." if none else ""
    elif fronts:
        words = "The line is the Pareto front of the passed runs: no other run has both less error "
        words += "and less gas."
    return (
        f'<h2>Error against gas</h2><p class="soft">{words}{apart.rest}</p>'
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
        f'<h2>Why runs did not pass</h2><div class="wide"><table><tr><th class="n">runs</th>'
        f"<th>reason</th></tr>{rows}</table></div>"
    )


def _worst(campaign: Campaign, runs: Sequence[FlownRun], error: Quantity, folder: Path) -> str:
    rows = []
    for run in worst_runs(runs, error):
        value = run.columns.get(error.column)
        words = "" if value is None else number(float(value) * error.scale)
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
        '<h2>Worst runs</h2><p class="soft">The command repeats a run bit '
        'for bit.</p><div class="wide"><table><tr><th class="n">run</th>'
        f'<th>ended</th><th class="n">{escape(error.titled)}</th><th>why</th><th>replay</th></tr>'
        f"{''.join(rows)}</table></div>"
    )


def _again(campaign: Campaign, folder: Path) -> str:
    place = escape(str(folder))
    return (
        "<h2>Data</h2><p>All numbers of all runs are in "
        f"<code>{place}/results.parquet</code>; the campaign file is "
        f"<code>{place}/campaign.toml</code>. Seeds "
        f"{campaign.file.seed} to {campaign.file.seed + campaign.file.samples - 1}.</p>"
    )
