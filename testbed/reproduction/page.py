"""A paper's page for the docs: what was claimed, what we found, how to repeat it."""

from testbed.reproduction.claim import CORRECTED, FAILS, HOLDS, UNTESTABLE, Paper, Row

QUICK = " These numbers are of `--quick`: fewer seeds, coarser steps."


def page(key: str, paper: Paper, rows: list[Row]) -> str:
    """Markdown."""
    counts = dict.fromkeys((HOLDS, CORRECTED, FAILS, UNTESTABLE), 0)
    for row in rows:
        counts[row.outcome] += 1
    said = ", ".join(f"{n} {kind}" for kind, n in counts.items())
    lines = [
        f"# {key}: {paper.title}", "", paper.source, "", paper.remark.strip(), "",
        f"Repeat: `testbed reproduce {key}`; this page is `testbed reproduce {key} --markdown`. "
        f"The runs and every number in them are in `configs/papers/{key}.toml`. "
        f"{len(rows)} claims: {said}.",
        "", "## Claims", "",
        "The worst of all seeds is measured." + QUICK * any(row.quick for row in rows), "",
        "| id | where | claim | paper | measured | verdict |",
        "|---|---|---|---|---|---|",
    ]  # fmt: skip
    for row in rows:
        note = f". {row.note}" if row.note else ""
        cells = (f"`{row.id}`", row.source, row.claim + note, _claimed(row), _found(row))
        lines.append("| " + " | ".join(_cell(c) for c in (*cells, row.outcome)) + " |")
    lines += ["", "## How the print is read", ""]
    for name, fix in paper.corrections.items():
        lines.append(
            f"* **{name}**, {fix.at}: printed {fix.printed}; read as {fix.read}. {fix.why}"
        )
    lines += ["", "## What is assumed", ""]
    lines += [f"* **{n}**: {guess.what}. {guess.why}" for n, guess in paper.assumptions.items()]
    return "\n".join(lines) + "\n"


def _claimed(row: Row) -> str:
    if isinstance(row.paper, str):
        return row.paper
    sign = {"at most": "<= ", "at least": ">= ", "equal": ""}[row.must]
    slack = f" (+- {row.tolerance:g})" if row.tolerance and row.must == "equal" else ""
    return f"{sign}{row.paper:.6g} {row.unit}".strip() + slack


def _found(row: Row) -> str:
    if row.outcome == UNTESTABLE:
        return row.verdict.partition(": ")[2]
    return "never" if row.measured is None else f"{row.measured:.4g} {row.unit}".strip()


def _cell(text: str) -> str:
    return text.replace("|", "\\|").replace("\n", " ")
