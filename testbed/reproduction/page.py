"""A paper's page for the docs: claims, results, how to reproduce them."""

from testbed.reproduction.claim import CHECK, CLAIM, UNTESTABLE, ClaimRow, Paper, claimed, counts

QUICK = " These numbers are of `--quick`: fewer seeds, coarser steps."


def page(key: str, paper: Paper, rows: list[ClaimRow]) -> str:
    """The paper's claims and verdicts as Markdown."""
    lines = [
        f"# {key}: {paper.title}", "", paper.source, "", paper.remark.strip(), "",
        f"Repeat: `testbed reproduce {key}`; this page is `testbed reproduce {key} --markdown`. "
        f"The runs and every number in them are in `configs/papers/{key}.toml`. "
        f"{counts(rows)}.",
        "", "## Claims", "",
        "The worst of all seeds is measured." + QUICK * any(row.quick for row in rows), "",
        "| id | where | claim | paper | measured | verdict |",
        "|---|---|---|---|---|---|",
    ]  # fmt: skip
    for row in rows:
        if row.kind == CLAIM:
            note = f". {row.note}" if row.note else ""
            cells = (row.source, row.claim + note, claimed(row), _found(row), row.outcome)
            lines.append(_line(f"`{row.id}`", *cells))
    checks = [row for row in rows if row.kind == CHECK]
    if checks:
        lines += [
            "", "## Input checks", "",
            "No claims of the paper: where its assumptions are broken, this software says so.", "",
            "| id | where | check | found |", "|---|---|---|---|",
        ]  # fmt: skip
        lines += [_line(f"`{r.id}`", r.source, r.claim, r.verdict) for r in checks]
    lines += ["", "## How the print is read", ""]
    for name, fix in paper.corrections.items():
        lines.append(
            f"* **{name}**, {fix.at}: printed {fix.printed}; read as {fix.read}. {fix.why}"
        )
    lines += ["", "## What is assumed", ""]
    lines += [f"* **{n}**: {guess.what}. {guess.why}" for n, guess in paper.assumptions.items()]
    return "\n".join(lines) + "\n"


def _line(*cells: str) -> str:
    return "| " + " | ".join(cell.replace("|", "\\|").replace("\n", " ") for cell in cells) + " |"


def _found(row: ClaimRow) -> str:
    if row.outcome == UNTESTABLE:
        return row.verdict.removeprefix("not reproducible: ")
    return "never" if row.measured is None else f"{row.measured:.4g} {row.unit}".strip()
