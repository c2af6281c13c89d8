"""The verbs that fly many runs: their arguments. What they do is imported when it is needed."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import click


def flown_into(default: str, result: str) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Options of all of them: where to, who flies, and the file that `--json` prints."""
    options = [
        click.option(
            "--out",
            type=click.Path(path_type=Path),
            help=f"Folder; one begun before is gone on with.  [default: {default}_<name>]",
        ),
        click.option(
            "--jobs", type=click.IntRange(1, 1024), default=1, show_default=True,
            help="Processes on this machine.",
        ),
        click.option("--scheduler", metavar="ADDRESS", help="Dask cluster that flies instead."),
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
    """Fly the many runs of a campaign FILE (docs/campaigns.md)."""
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
    """Choose gains within the bounds of a tuning FILE.

    The best are written as an experiment (docs/campaigns.md).
    """
    from testbed.cli.tune import run_tuning

    context.exit(run_tuning(file, out, jobs, scheduler, as_json))


@click.command()
@click.argument("file", required=False)
@flown_into("runs/benchmark", "scores.json")
@click.option("--samples", type=click.IntRange(1, 10_000), help="Seeds; the file says how many.")
@click.option("--only", multiple=True, metavar="SCENARIO", help="Some scenarios; may be repeated.")
@click.option("--from", "runs", metavar="FOLDER",
              type=click.Path(path_type=Path, exists=True, file_okay=False),
              help="Score run folders in FOLDER/scenario/law/ instead of flying.")  # fmt: skip
@click.option("--commands", is_flag=True, help="Print the commands that fly it run by run.")
@click.pass_context
def bench(
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

    Standard scenarios under all laws; FILE, if given, is another benchmark than the shipped one.
    """
    from testbed.cli.benchmark import run_benchmark

    context.exit(run_benchmark(file, out, jobs, scheduler, as_json, samples, only, runs, commands))
