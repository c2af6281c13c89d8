"""The benchmark as a page of the documentation, made from files and runs only."""

import textwrap
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from testbed.campaign.benchmark import BenchmarkFile, BenchmarkScenario, Record, Score
from testbed.campaign.folders import plays
from testbed.campaign.interval import success_rate
from testbed.campaign.sweep import base_experiment
from testbed.config import SHIPPED, Experiment, dump
from testbed.config.key import assignment
from testbed.core.spelling import counted

WIDTH = 100  # characters per line
WEAK = 0.9  # a lower end of the interval below this is weak evidence

COLUMNS = (  # heading, key, scale, format
    ("error [mm]", "error_m", 1e3, "{:.3g}"),
    ("worst [mm]", "worst_error_m", 1e3, "{:.3g}"),
    ("settled [s]", "settle_s", 1.0, "{:.0f}"),
    ("obstacles [m]", "clearance_m", 1.0, "{:+.3f}"),
    ("vehicles [m]", "vehicle_distance_m", 1.0, "{:.2f}"),
    ("contacts", "contacts", 1.0, "{:.0f}"),
    ("gas [g]", "gas_g", 1.0, "{:.1f}"),
    ("valve pulses", "valve_pulses", 1.0, "{:.0f}"),
)


PAGE = """# The benchmark of record

{head}

{table}
{columns}
{reasons}
## What is flown, and when it has passed

{scenarios}

## How sure this is

{evidence}
{notes}{lab}"""

MEANING = (
    "**passed**: runs that reached their end without a fault, met the scenario's criteria and kept "
    "the benchmark's bounds, as given below.",
    "**error**: RMS of the distance to the goal, where it is by then, in the last 30 s; in the "
    "second half of the run where the goal moves. Of a formation, RMS of the distances between "
    "partners less the wanted ones; none where there is neither. The worst vehicle of a run; "
    "median over the runs, and the worst of them.",
    "**settled**: after that the position stays within 50 mm of the goal, at any heading; median; "
    "none if a run did not settle.",
    "**obstacles**: smallest distance to an obstacle less its danger radius; negative is inside. "
    "**vehicles**: smallest distance between two, centre to centre.",
    "**contacts**: of all runs together. **gas**, **valve pulses**: all vehicles of a run, median.",
    "A run that a fault ended is worse than any in **error**, **gas** and **valve pulses**: a "
    "median that it would be, and the worst error, are not given.",
)


def page(record: Record, path: Path, file: BenchmarkFile, options: str) -> str:
    """The page with the scores and their explanation.

    It has no date, because the same program writes the same page on any day.

    Args:
        record: the scores.
        path: path of the benchmark file.
        file: its content, reduced to what was flown.
        options: options of `testbed benchmark`.
    """
    meaning = list(MEANING)
    if file.trouble and any(row.robust_runs for row in record.scores):
        meaning.append(
            "**robust**: passed with the same seeds and with changes that the laws do not know: "
            f"{'; '.join(f'`{text}`' for text in file.trouble)}."
        )
    return PAGE.format(
        head=wrapped(head(record, path, options)),
        table=markdown(record.scores),
        columns=bullets(meaning),
        reasons=not_passed(record.scores),
        scenarios=bullets(scenarios(path, file)),
        evidence=wrapped(evidence(record.scores)),
        notes=f"\n{bullets(file.notes)}\n" if file.notes else "",
        lab=lab(record, file),
    )


def not_passed(table: Sequence[Score]) -> str:
    """The section that says why runs did not pass; empty if all did."""
    lines = [f"**{row}**: {why}" for row, why in reasons_of(table)]
    return f"\n## Why runs did not pass\n\n{bullets(lines)}\n" if lines else ""


def reasons_of(table: Sequence[Score]) -> Iterator[tuple[str, str]]:
    """Each row with runs that did not pass, and why, with the number of runs."""
    for row in table:
        for kind, why in (("", row.reasons), (" (robust)", row.robust_reasons)):
            if why:
                words = "; ".join(f"{reason} ({count})" for reason, count in why.items())
                yield f"{row.scenario}, {row.law}{kind}", words


def head(record: Record, path: Path, options: str) -> str:
    """The introduction: runs, rigs, seeds, program version."""
    rigs = " and ".join(
        sorted({f"the {rig}" for row in record.scores for rig in row.rig.split(" + ")})
    )
    runs = sum(row.runs + row.robust_runs for row in record.scores)
    counts = {row.runs for row in record.scores}
    seeds = f"{'at most ' * (len(counts) > 1)}{counted(max(counts), 'seed')}"
    code = f" (code {record.code})" if record.code else ""
    try:
        name = f"configs/{path.resolve().relative_to(SHIPPED.resolve()).as_posix()}"
    except ValueError:
        name = path.name
    return (
        "Standard scenarios under all laws, all scored the same way. This page was written "
        f"by `testbed benchmark{options}`: {counted(runs, 'run')} on {rigs}, {seeds} "
        f"per cell, flown by airbearing-testbed {record.version}{code}. "
        f"`{name}` has the scenarios and the laws' gains, which were not tuned for it; "
        "[campaigns.md](campaigns.md) says how to fly it on a table. The page has no date, "
        "because the same program writes the same page on any day."
    )


def scenarios(path: Path, file: BenchmarkFile) -> Iterator[str]:
    """One sentence per scenario: what is flown, and the limits."""
    for name, scenario in file.scenarios.items():
        flown = base_experiment(path, scenario.experiment, scenario.set)
        what = scenario.description or flown.description
        overrides = [text for text in scenario.set if assignment(text)[0][0] != "criteria"]
        if overrides:  # criteria are among the limits
            what += f", with {', '.join(f'`{text}`' for text in overrides)}"
        many = counted(len(flown.vehicles), "vehicle")
        limits = ", ".join(bounds(scenario, flown)) or "the end of the run"
        yield f"**{name}**: {what}; {many}, {flown.duration_s:g} s. Passed: {limits}."


def bounds(scenario: BenchmarkScenario, flown: Experiment) -> Iterator[str]:
    """The limits of the experiment's criteria and of the benchmark."""
    yield from limits_of("", dump(flown)["criteria"], obstacles=bool(flown.obstacles))
    for sign, those in (("at most", scenario.most), ("at least", scenario.least)):
        yield from (f"`{name}` {sign} {limit:g}" for name, limit in those.items())


def limits_of(above: str, criteria: dict[str, Any], *, obstacles: bool) -> Iterator[str]:
    """The criteria of an experiment, one by one."""
    for name, limit in criteria.items():
        if isinstance(limit, dict):
            yield from limits_of(f"{above}{name}.", limit, obstacles=obstacles)
        elif isinstance(limit, bool):
            if limit and obstacles:
                yield f"`{above}{name}`"
        else:
            verb = "" if name.startswith("max_") else "at most "
            yield f"`{above}{name}` {verb}{limit:g}"


def evidence(table: Sequence[Score]) -> str:
    """How much evidence the number of runs gives."""
    runs = max(row.runs for row in table)
    all_of, none_of = (success_rate(passed, runs, 0.95) for passed in (runs, 0))
    weak = "is weak evidence: " if all_of.low < WEAK else "is no proof: "
    return (
        f"{runs} of {runs} {weak}a law whose true rate is anywhere from "
        f"{100 * all_of.low:.0f} to {100 * all_of.high:.0f} % may well show it (Wilson's interval "
        f"of 95 %; of 0 of {runs}: {100 * none_of.low:.0f} to {100 * none_of.high:.0f} %). The "
        "table says which law can fly what, and how well; it does not say how often a law fails, "
        "and one run more or less does not tell two laws apart. For a rate, more seeds: `testbed "
        "benchmark --samples 100`."
    )


def lab(record: Record, file: BenchmarkFile) -> str:
    """Own settings of a lab, and what was not scored; empty for the twin's benchmark."""
    text = ""
    disturbed = [row.scenario for row in record.scores if unseen(row, file.scenarios[row.scenario])]
    if disturbed:
        names = ", ".join(f"`{name}`" for name in dict.fromkeys(disturbed))
        text += wrapped(
            f"The lab makes the disturbances of {names} itself; the run folders do not show "
            "whether it did."
        )
        text = f"\n{text}\n"
    passed_over = [f"`{one.folder}`: {one.reason}" for one in record.passed_over]
    for heading, lines in (
        ("Different from the benchmark, but scored", [f"`{one}`" for one in record.own]),
        ("Not flown", record.not_flown),
        ("Skipped, not scored", passed_over),
    ):
        if lines:
            text += f"\n## {heading}\n\n{bullets(lines)}\n"
    return text


def unseen(row: Score, scenario: BenchmarkScenario) -> bool:
    """Whether a row's disturbance was made by people instead of its rig."""
    keys = [assignment(text)[0] for text in scenario.set]
    rigs = row.rig.split(" + ")
    return bool(scenario.hardware) and any(not plays(rig, key) for rig in rigs for key in keys)


def wrapped(text: str, indent: str = "") -> str:
    """The text as a wrapped paragraph."""
    return textwrap.fill(
        text, WIDTH, subsequent_indent=indent, break_long_words=False, break_on_hyphens=False
    )


def bullets(lines: Sequence[str] | Iterator[str]) -> str:
    """The lines as a bulleted list."""
    return "\n".join(wrapped(f"* {line}", "  ") for line in lines)


def markdown(table: Sequence[Score]) -> str:
    """The benchmark's table as a Markdown page."""
    rigs = any(row.rig != "twin" for row in table)
    headings = ["scenario", "law", "passed", *(h for h, *_ in COLUMNS), "robust"]
    headings += ["rig"] * rigs
    lines = ["| " + " | ".join(headings) + " |", "|---|---|" + "---:|" * (len(headings) - 2)]
    for scenario, law, *numbers in cells_of(table):
        lines.append("| " + " | ".join([scenario, f"`{law}`", *numbers]) + " |")
    return "\n".join(lines) + "\n"


def cells_of(table: Sequence[Score]) -> Iterator[list[str]]:
    """The cells of each score; the scenario is named in its first row only."""
    rigs, before = any(row.rig != "twin" for row in table), ""
    for row in table:
        cells = [row.scenario if row.scenario != before else "", row.law]
        cells.append(f"{row.passed}/{row.runs}")
        for _, key, scale, form in COLUMNS:
            value = getattr(row, key)
            cells.append("-" if value is None else form.format(scale * value))
        cells.append(f"{row.robust_passed}/{row.robust_runs}" if row.robust_runs else "-")
        yield cells + [row.rig] * rigs
        before = row.scenario
