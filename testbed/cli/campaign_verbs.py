"""Arguments of the verbs that fly many runs; the implementation is imported when a verb runs."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import click


def flown_into(default: str, result: str) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Options that all of them have: output folder, workers, and the file that `--json` prints."""
    options = [
        click.option(
            "--out",
            type=click.Path(path_type=Path),
            help=f"Output folder; resumes an unfinished one.  [default: {default}_<name>]",
        ),
        click.option(
            "--jobs", type=click.IntRange(1, 1024), default=1, show_default=True,
            help="Worker processes on this machine.",
        ),
        click.option("--scheduler", metavar="ADDRESS", help="Fly on this Dask cluster instead."),
        click.option("--json", "as_json", is_flag=True, help=f"Print {result} and nothing else."),
    ]  # fmt: skip

    def decorate(command: Callable[..., Any]) -> Callable[..., Any]:
        for option in reversed(options):
            command = option(command)
        return command

    return decorate


@click.command()
@click.argument("file")
@flown_into("runs/campaign", "summary.json")
@click.pass_context
def campaign(
    context: click.Context, file: str, out: Path | None, jobs: int, scheduler: str | None,
    as_json: bool,
) -> None:  # fmt: skip
    """Fly all runs of a campaign FILE (docs/campaigns.md)."""
    from testbed.cli.campaign import run_campaign

    context.exit(run_campaign(file, out, jobs, scheduler, as_json))


@click.command()
@click.argument("file")
@flown_into("runs/tuning", "tuning.json")
@click.pass_context
def tune(
    context: click.Context, file: str, out: Path | None, jobs: int, scheduler: str | None,
    as_json: bool,
) -> None:  # fmt: skip
    """Optimise gains within the bounds of a tuning FILE.

    Writes the best gains as an experiment (docs/campaigns.md).
    """
    from testbed.cli.tune import run_tuning

    context.exit(run_tuning(file, out, jobs, scheduler, as_json))


@click.command()
@click.argument("file", required=False)
@flown_into("runs/benchmark", "scores.json")
@click.option(
    "--samples", type=click.IntRange(1, 10_000), help="Number of seeds.  [default: from FILE]"
)
@click.option(
    "--only", multiple=True, metavar="SCENARIO", help="Fly only this scenario; repeatable."
)
@click.option("--from", "runs", metavar="FOLDER",
              type=click.Path(path_type=Path, exists=True, file_okay=False),
              help="Score run folders in FOLDER/scenario/law/ instead of flying.")  # fmt: skip
@click.option(
    "--commands", is_flag=True, help="Print one `testbed run` command per run instead of flying."
)
@click.pass_context
def benchmark(
    context: click.Context,
    file: str | None,
    out: Path | None,
    jobs: int,
    scheduler: str | None,
    samples: int | None,
    only: tuple[str, ...],
    runs: Path | None,
    commands: bool,
    as_json: bool,
) -> None:
    """Fly the benchmark of record (docs/benchmark.md).

    Flies the standard scenarios with all laws. FILE replaces the shipped benchmark.
    """
    from testbed.cli.benchmark import run_benchmark

    context.exit(run_benchmark(file, out, jobs, scheduler, as_json, samples, only, runs, commands))
