"""report.html: a run as a self-contained page."""

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from html import escape
from pathlib import Path

import msgspec

from testbed.config.experiment import Experiment
from testbed.core.error import TestbedError
from testbed.logs.history import History
from testbed.metrics.formation import has_formation
from testbed.metrics.run_metrics import SETTLED_M, FormationMetrics, Metrics
from testbed.report.chart import THEME, alone, draw
from testbed.report.events import happened, lines
from testbed.report.fault_story import EventLine
from testbed.report.figures import analogue, figures
from testbed.report.fork_changes import fork_changes
from testbed.report.item import HUES, Chart
from testbed.report.jets import jets_table
from testbed.report.law import law_of
from testbed.report.original import Original, with_original
from testbed.report.provenance import provenance, timing
from testbed.report.scrubber import bar, flight_data
from testbed.report.verdict import CRITERIA, UNCOUNTED, missed, reasons, verdict

CSS = Path(__file__).with_name("report.css").read_text(encoding="utf-8")
SCRIPT = Path(__file__).with_name("report.js").read_text(encoding="utf-8")
NOT_A_TABLE = {
    "twin": "Simulated on the twin, not flown on a table.",
    "bench": "Flown on the bench: the network is real, the table is simulated by the twin.",
}
FIRST = ("trajectory", "error", "error_xy", "near")  # figures before the numbers

NEAREST = "min_obstacle_distance_m"
ROWS = (  # heading, key of VehicleMetrics, scale, digits, criterion
    ("final error [mm]", "final_error_m", 1e3, 2, "final_error_m"),
    (f"settled to {1e3 * SETTLED_M:.0f} mm [s]", "settle_s", 1.0, 1, "settle_s"),
    ("tracking RMS [mm]", "track_rms_m", 1e3, 2, "track_rms_m"),
    ("hold RMS [mm]", "hold_rms_m", 1e3, 2, "hold_rms_m"),
    ("heading RMS [deg]", "heading_rms_deg", 1.0, 3, "heading_rms_deg"),
    ("nearest obstacle [m]", NEAREST, 1.0, 3, "clear_of_obstacles"),
    ("impulse [N s]", "impulse_ns", 1.0, 1, "impulse_ns"),
    ("gas [g]", "gas_g", 1.0, 1, ""),
    ("valve pulses", "valve_pulses", 1.0, 0, ""),
    ("filtered by safety [N s]", "filtered_ns", 1.0, 2, ""),
    ("largest force asked [N]", "max_force_n", 1.0, 2, ""),
)
MISSED = ' class="missed"'  # of a cell or a tile
TILES_JUDGED = {"nearest obstacle, centres": "clear_of_obstacles", "contacts": "max_contacts"}
OF_A_GOAL = ("final_error_m", "settle_s", "track_rms_m", "hold_rms_m")


def rows_of(experiment: Experiment) -> list[tuple[str, str, float, int, str]]:
    """Rows that apply to an experiment: a formation has no goals, a bare table no obstacle."""
    has_goals = not has_formation(experiment.controller)
    return [
        row
        for row in ROWS
        if (has_goals or row[1] not in OF_A_GOAL) and (experiment.obstacles or row[1] != NEAREST)
    ]


class ReportError(TestbedError):
    """The report cannot be written, or its data cannot be read."""


def write_report(
    folder: Path, scenario: Experiment, history: History, metrics: Metrics, config: str,
    original: Original | None = None, changed: Sequence[str] = (),
) -> list[Path]:  # fmt: skip
    """Write report.html and figures/*.svg to a run folder; returns the files, the report first.

    `changed` are changes of a fork that its experiment does not tell.
    """
    events = lines(scenario, history, metrics.touches)
    charts = figures(scenario, history, metrics.touches, events)
    if original is not None:
        charts = with_original(charts, figures(scenario, original.history), original)
    drawn = {chart.key: draw(chart) for chart in charts}
    try:
        drawings = folder / "figures"
        drawings.mkdir(exist_ok=True)
        paths = [folder / "report.html"]
        for chart in charts:
            paths.append(drawings / f"{chart.key}.svg")
            paths[-1].write_text(alone(chart, drawn[chart.key]), encoding="utf-8")
        text = render(scenario, history, metrics, config, charts, drawn, events, changed)
        paths[0].write_text(text, encoding="utf-8")
    except OSError as error:
        raise ReportError(
            where=str(error.filename or paths[-1]), expected="a writable path",
            found=str(error.strerror),
        ) from None  # fmt: skip
    return paths


def render(
    scenario: Experiment, history: History, metrics: Metrics, config: str,
    charts: Sequence[Chart], drawn: Mapping[str, str], events: Sequence[EventLine],
    changed: Sequence[str] = (),
) -> str:  # fmt: skip
    """The page as HTML; `drawn` are the drawings of the charts, by their keys."""
    first = FIRST if any(c.key == "error_xy" for c in charts) else (*FIRST, "separation")
    phases = [c for c in charts if c.key.startswith("phase_")]
    later = [c for c in charts if c.key not in first and c not in phases]
    side_by_side = "".join(figure(c, drawing=drawn[c.key]) for c in phases)
    pictures = (
        "<h2>Trajectories</h2>", _figures(scenario, [c for c in charts if c.key in first], drawn),
        f'<div class="phases">{side_by_side}</div>' * bool(phases),
    )  # fmt: skip
    summary = _tiles(scenario, metrics), _flown(scenario, changed), _warnings(metrics)
    failed = verdict(scenario, metrics).look == "fault"  # then the picture comes first
    sections = [
        _header(scenario, metrics),
        *((*pictures, happened(events), *summary) if failed
          else (*summary, *pictures, happened(events))),
        _criteria(scenario, metrics),
        _results(scenario, metrics), jets_table(metrics),
        "<h2>Figures</h2>", _figures(scenario, later, drawn),
        timing(metrics),
        provenance(metrics, config),
        bar(flight_data(scenario, history, events)),
    ]  # fmt: skip
    return page(f"{metrics.experiment}, {metrics.rig}", "\n".join(sections), script=SCRIPT)


def page(title: str, body: str, style: str = "", script: str = "") -> str:
    """A complete HTML page around `body`, with more style and a script if given."""
    scripts = f"<script>{script}</script>" * bool(script)
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{escape(title)}</title><style>{THEME}{CSS}{style}</style></head>\n"
        f"<body><main>\n{body}\n</main>{scripts}</body></html>\n"
    )


def _header(scenario: Experiment, metrics: Metrics) -> str:
    look, words = verdict(scenario, metrics)
    where = f"on the {metrics.rig}, seed {metrics.seed}"
    story = "".join(f'<p class="not">{escape(one)}</p>' for one in reasons(scenario, metrics))
    note = f'<p class="soft">{NOT_A_TABLE[metrics.rig]}</p>' if metrics.rig in NOT_A_TABLE else ""
    return (
        f"<header><div><h1>{escape(metrics.experiment)}</h1>"
        f'<p class="soft">{escape(scenario.description)} &middot; {where}</p>{story}{note}</div>'
        f'<div class="verdict {look}">{escape(words)}</div></header>'
    )


def together_of(scenario: Experiment, metrics: Metrics) -> FormationMetrics | None:
    """Metrics of the formation; None if the law controls no formation."""
    if metrics.formation is None or not has_formation(scenario.controller):
        return None
    return metrics.formation


def _tiles(scenario: Experiment, metrics: Metrics) -> str:
    def worst(key: str) -> float | None:
        values = [getattr(one, key) for one in metrics.vehicles.values()]
        return max((v for v in values if v is not None), default=None)

    near = [v.min_obstacle_distance_m for v in metrics.vehicles.values()]
    nearest = min((v for v in near if v is not None), default=None)
    fixed = [one for name, one in metrics.vehicles.items() if not scenario.vehicles[name].path]
    settled = [one.settle_s for one in fixed]
    late = [v for v in settled if v is not None]
    gas = [v.gas_g for v in metrics.vehicles.values() if v.gas_g is not None]
    of_goals: tuple[tuple[str, str, str], ...] = (
        ("settled, last vehicle", _number(worst("settle_s"), 1.0, 1), "s")
        if len(late) in (0, len(settled))
        else ("vehicles settled", f"{len(late)} of {len(settled)}", ""),
        ("hold RMS, worst", _number(worst("hold_rms_m"), 1e3, 2), "mm"),
        ("tracking RMS, worst", _number(worst("track_rms_m"), 1e3, 2), "mm"),
    )
    if has_formation(scenario.controller):
        f = together_of(scenario, metrics)
        of_goals = (
            ("formation settled", _number(f.settled_s if f else None, 1.0, 1), "s"),
            ("formation, error at the end", _number(f.error_m if f else None, 1e3, 1), "mm"),
            ("longest edge", _number(f.longest_edge_m if f else None, 1.0, 2), "m"),
        )
    tiles = (
        ("flown", _number(metrics.duration_s, 1.0, 0 if metrics.duration_s >= 10.0 else 1), "s"),
        *of_goals,
        *[("nearest obstacle, centres", _number(nearest, 1.0, 2), "m")] * bool(scenario.obstacles),
        *[("nearest vehicles, centres", _number(metrics.min_vehicle_distance_m, 1.0, 2), "m")]
        * (len(scenario.vehicles) > 1),
        ("contacts", DASH if metrics.contacts == UNCOUNTED else str(metrics.contacts), ""),
        ("gas, total", _number(sum(gas) if gas else None, 1.0, 0), "g"),
    )
    judged = metrics.criteria or {}
    bad = {name for name, key in TILES_JUDGED.items() if judged.get(key) is False}
    return f'<div class="tiles{" six" * (len(tiles) == 6)}">' + "".join(
        f'<div class="tile"><b{MISSED * (name in bad)}>{value}'
        f"{f' {unit}' if value != DASH else ''}</b><span>{name}</span></div>"
        for name, value, unit in tiles
    ) + "</div>"  # fmt: skip


DASH, JOINT = "\N{EN DASH}", "\N{NO-BREAK SPACE}"


def _number(value: float | None, scale: float, digits: int) -> str:
    if value is None or math.isnan(value):
        return DASH
    return _signed(rounded(scale * value, digits))


def rounded(value: float, digits: int) -> str:
    """`value` with so many decimals, with fewer if it is large: 0.26, 44.29, 237.9, 2433."""
    most = 3 - math.floor(math.log10(max(abs(value), 1.0)))
    return f"{value:.{max(0, min(digits, most))}f}"


def _three_digits(value: float) -> str:
    return f"{value:.0f}" if abs(value) >= 1000.0 else f"{value:.3g}"


def _signed(text: str) -> str:
    """`text` with typographic minus signs, without that of a zero."""
    return re.sub(r"-(?!0(\.0*)?(?![\d.]))", "\N{MINUS SIGN}", text).replace("-", "")


def _dot(k: int) -> str:
    """A dot in the colour of the k-th vehicle."""
    return f'<span class="dot" style="background:var(--h{k % HUES})"></span>'


def _pose(pose: tuple[float, float, float]) -> str:
    x, y, theta = pose
    turn = f"{math.degrees(theta):.0f}\N{DEGREE SIGN}"
    return _signed(f"({x:.2f}, {y:.2f}){JOINT}m, {turn}")  # three lines on a phone


def _flown(scenario: Experiment, changed: Sequence[str]) -> str:
    size = scenario.table.size
    obstacles = [
        f"{escape(name)} at {_signed(f'({o.position[0]:g}, {o.position[1]:g})')} m, "
        f"danger radius {o.radius:g} m"
        for name, o in scenario.obstacles.items()
    ]
    words = (
        f"Law <b>{escape(law_of(scenario))}</b> in {scenario.guidance.mode} mode, jet period "
        f"{1e3 * scenario.flight.jet_period_s:g} ms, on a table of {size[0]:g} m "
        f"\N{MULTIPLICATION SIGN} {size[1]:g} m."
        + (f" Obstacles: {'; '.join(obstacles)}." if obstacles else " No obstacles.")
        + f" Planned: {scenario.duration_s:g} s."
        + "".join(f" {escape(one)}" for one in fork_changes(scenario, changed))
    )
    has_goals = not has_formation(scenario.controller)
    rows = "".join(
        f"<tr><td>{_dot(k)}{escape(name)}</td>"
        f"<td>{_pose(s.start)}</td>{f'<td>{_pose(s.goal)}</td>' * has_goals}"
        f"<td>{s.model.mass:g}</td>"
        f"<td>{s.model.radius:g}</td><td>{len(s.model.jets)} "
        f"\N{MULTIPLICATION SIGN} {s.model.jets[0].thrust:g}{JOINT}N</td></tr>"
        for k, (name, s) in enumerate(scenario.vehicles.items())
    )
    return (
        f"<h2>Experiment</h2><p>{words}</p>"
        '<div class="wide"><table><tr><th>vehicle</th><th>start</th>'
        f"{'<th>goal</th>' * has_goals}<th>mass [kg]</th><th>radius [m]</th><th>jets</th></tr>"
        f"{rows}</table></div>"
    )


def _warnings(metrics: Metrics) -> str:
    """Warnings of the run, such as violated conditions of the law's proof, as HTML."""
    texts: dict[str, list[str]] = {}
    for one in metrics.warnings:
        texts.setdefault(one.name, []).append(one.text)
    rows = "".join(
        f"<li><b>{escape(name)}</b>: {escape(some[0])}{_more(some[1:])}</li>"
        for name, some in texts.items()
    )
    return f'<div class="warnings"><b>Warnings</b><ul>{rows}</ul></div>' if rows else ""


def _more(texts: Sequence[str]) -> str:
    """More warnings of the same name, folded."""
    lines = "".join(f"<li>{escape(one)}</li>" for one in dict.fromkeys(texts))
    count = f"{len(texts)} more"
    return f"<details><summary>{count}</summary><ul>{lines}</ul></details>" if texts else ""


def _criteria(scenario: Experiment, metrics: Metrics) -> str:
    if metrics.criteria is None:
        why = "The flight was not completed, so no criterion is judged."
        if metrics.red:
            why = "There was no flight, so no criterion is judged."
        return f"<h2>Criteria</h2><p>{why}</p>"
    if not metrics.criteria:
        return ""
    criteria, together = scenario.criteria, together_of(scenario, metrics)
    rows = []
    for key, met in metrics.criteria.items():
        (name, unit, scale), least = CRITERIA.get(key, (key, "", 1.0)), DASH
        whose, _, part = key.rpartition(".")
        limit = getattr(criteria.formation if whose else criteria, part, None)
        values = [getattr(v, key, None) for v in metrics.vehicles.values()]
        known = [v for v in values if isinstance(v, int | float)]
        found = DASH
        if known and len(known) == len(values):
            found = f"{_three_digits(scale * max(known))} {unit}"
        if key == "max_contacts":
            found = str(metrics.contacts)
        if key == "clear_of_obstacles":
            near = [v.min_obstacle_distance_m for v in metrics.vehicles.values()]
            seen = [v for v in near if v is not None]
            found = f"{min(seen):.3f} m" if seen else "no obstacles"
            radii = {obstacle.radius for obstacle in scenario.obstacles.values()}
            if len(radii) == 1:
                name, limit = "nearest obstacle, centres", None
                least = f"\N{GREATER-THAN OR EQUAL TO} {max(radii):g} m"
        if whose and (value := getattr(together, part, None)) is not None:
            found = f"{_three_digits(scale * value)} {unit}"
        bound = "yes" if isinstance(limit, bool) else "\N{LESS-THAN OR EQUAL TO} "
        if not isinstance(limit, bool):
            bound = least if limit is None else f"{bound}{scale * limit:g} {unit}"
        verdict = '<span class="met">met</span>' if met else '<span class="not">not met</span>'
        cells = "".join(f'<td class="value">{one}</td>' for one in (bound, found, verdict))
        rows.append(f"<tr><td>{name}</td>{cells}</tr>")
    return (
        '<h2>Criteria</h2><div class="wide"><table><tr><th>criterion</th><th>limit</th>'
        f"<th>found, worst vehicle</th><th>verdict</th></tr>{''.join(rows)}</table></div>"
    )


def _results(scenario: Experiment, metrics: Metrics) -> str:
    names = "".join(f"<th>{_dot(k)}{escape(name)}</th>" for k, name in enumerate(metrics.vehicles))
    rows = []
    for heading, key, scale, digits, criterion in rows_of(scenario):
        cells = "".join(
            f"<td{MISSED * missed(scenario, metrics, name, key, criterion)}>"
            f"{_number(getattr(one, key), scale, digits)}</td>"
            for name, one in metrics.vehicles.items()
        )
        rows.append(f"<tr><td>{heading}</td>{cells}</tr>")
    return (
        '<h2>Results</h2><div class="wide"><table>'
        f"<tr><th>number</th>{names}</tr>{''.join(rows)}</table></div>"
    )


def _figures(scenario: Experiment, charts: Iterable[Chart], drawn: Mapping[str, str]) -> str:
    return '<div class="figures">' + "".join(
        figure(chart, analogue(scenario, chart.key), drawn[chart.key]) for chart in charts
    ) + "</div>"  # fmt: skip


def figure(chart: Chart, paper: str = "", drawing: str | None = None) -> str:
    """A figure with caption, as HTML; `drawing` is what `draw` has given for it."""
    looks = {"near": ' class="tall"', "valves": ' class="full"', "trajectory": ' class="tall"'}
    full = looks.get(chart.key, "")
    also = f' <span class="soft">({escape(paper)})</span>' if paper else ""
    note = f"<p>{escape(chart.note)}</p>" if chart.note else ""
    return (
        f'<figure id="{chart.key}"{full}><figcaption><b>{escape(chart.title)}</b>{also}'
        f"</figcaption>{drawing or draw(chart)}{note}</figure>"
    )


def read_metrics(folder: Path) -> Metrics:
    """Read metrics.json of a run.

    Raises:
        ReportError: the file is missing or of another version.
    """
    path = folder / "metrics.json"
    try:
        return msgspec.json.decode(path.read_bytes(), type=Metrics)
    except OSError as error:
        raise ReportError(f"{path}: {error.strerror}") from None
    except msgspec.DecodeError as error:
        raise ReportError(
            where=str(path), expected="the metrics of a run", found=str(error)
        ) from None
