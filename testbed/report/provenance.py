"""The end of a report: timing, versions, and how to reproduce the run."""

import platform
from collections.abc import Mapping
from html import escape
from importlib.metadata import PackageNotFoundError, version

from testbed.metrics.run_metrics import Metrics

PACKAGES = ("airbearing-testbed", "numpy", "numba", "scipy", "msgspec", "mcap")


FLOWN = "# Flown"  # begins the line of config.toml with the date and the versions of a flight


def flown(config: str) -> str:
    """Date, code and versions of the flight, from its config.toml; empty: an older run."""
    return next((line for line in config.splitlines() if line.startswith(FLOWN)), "")[2:]


def versions() -> Mapping[str, str]:
    """Versions of Python, the system and the packages of this process."""
    found = {"Python": platform.python_version(), "system": platform.platform(terse=True)}
    for name in PACKAGES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            continue
    return found


def timing(metrics: Metrics) -> str:
    """The section on the timing of a flight by the wall clock."""
    late, half, most = (
        metrics.lateness_p99_ms, metrics.pose_to_valve_p50_ms, metrics.pose_to_valve_p99_ms
    )  # fmt: skip
    sentences = []
    if late is not None:
        sentences.append(f"99 % of the ticks began at most {late:.2f} ms late")
    if half is not None and most is not None:
        sentences.append(f"pose to valve took {half:.2f} ms in the median, {most:.2f} ms in 99 %")
    if (c := metrics.commands) is not None:
        sentences.append(
            f"of {c.sent} setpoints {c.late} came late, {c.expired} expired, {c.rejected} rejected"
        )
    return f"<h2>Timing</h2><p>{sentence(sentences)}</p>" if sentences else ""


def sentence(pieces: list[str]) -> str:
    """Join pieces to one sentence, with a capital and a full stop."""
    words = "; ".join(pieces)
    return f"{words[:1].upper()}{words[1:]}."


def provenance(metrics: Metrics, config: str) -> str:
    """The last section: the commands, the versions, the configuration."""
    used = flown(config) or "The run folder does not say when and with which code it was flown"
    pace = ""
    if metrics.real_time_factor:
        pace = (
            f"<p>The flight took {metrics.wall_s:.1f} s of wall time, "
            f"{metrics.real_time_factor:.1f} times real time.</p>"
        )
    return (
        f"<h2>How to reproduce the run</h2>{pace}<p>In this folder:</p>"
        "<pre>testbed run config.toml           # the same flight, bit-identical on the twin\n"
        "testbed replay .                  # the log through the current code\n"
        "testbed export . --to parquet     # the log as tables</pre>"
        f'<p class="soft" id="provenance">{escape(used)}. The figures are also in'
        " figures/*.svg.</p>"
        "<details><summary>Complete configuration (config.toml)</summary>"
        f"<pre>{escape(config)}</pre></details>"
    )
