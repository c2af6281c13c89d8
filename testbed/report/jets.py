"""The jets of each vehicle as the flight has shown them, for report.html."""

from html import escape

from testbed.metrics.run_metrics import Metrics


def jets_table(metrics: Metrics) -> str:
    """A table: share of thrust that each jet gave, with its sigma, and how it was flown."""
    known = metrics.jets
    if not known:
        return ""
    most = max(map(len, known.values()))
    head = "".join(f"<th>jet {k + 1}</th>" for k in range(most))
    rows = []
    for name, jets in known.items():
        cells = "".join(
            f"<td>{100.0 * one.share:.0f} \N{PLUS-MINUS SIGN} {100.0 * one.sigma:.0f}"
            f"{f'<br>{escape(one.words)}' * bool(one.words)}</td>"
            for one in jets
        )
        rows.append(f"<tr><td>{escape(name)}</td>{cells}{'<td></td>' * (most - len(jets))}</tr>")
    return (
        "<h2>Jets</h2><p>Share of the thrust in the vehicle file, in percent, estimated in flight."
        " 30 % of uncertainty: the jet was hardly commanded.</p>"
        f'<div class="wide"><table><tr><th>vehicle</th>{head}</tr>{"".join(rows)}</table></div>'
    )
