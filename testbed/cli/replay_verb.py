"""The verb that takes up a recorded run: its arguments."""

from pathlib import Path

import click

from testbed.cli.exit_code import BAD_INPUT


@click.command()
@click.argument("run", type=click.Path(exists=True, path_type=Path))
@click.argument("overrides", nargs=-1, metavar="[KEY=VALUE]...")
@click.option("--json", "as_json", is_flag=True, help="Print JSON and nothing else.")
@click.option("--view", is_flag=True, help="Play the run in the dashboard afterwards.")
@click.option(
    "--from",
    "since",
    type=click.FloatRange(min=0.0),
    metavar="T",
    help="Fly the run again up to T seconds, and on from there with KEY=VALUE.",
)
@click.option(
    "--out", type=click.Path(path_type=Path),
    help="With --from: run folder, new or empty.  [default: runs/<UTC time>_<name>]",
)  # fmt: skip
@click.pass_context
def replay(
    context: click.Context, run: Path, overrides: tuple[str, ...], as_json: bool, view: bool,
    since: float | None, out: Path | None,
) -> None:  # fmt: skip
    """Run the logged inputs of a RUN through the current code.

    The exit code is 1 if an output differs from the log in any bit. With --from a new flight is
    made, which is the RUN's up to that time; the exit codes are those of `testbed run`.
    """
    from testbed.cli.replay import fork_run, replay_run

    if since is not None and view:
        raise click.UsageError("--view plays RUN; the new run of --from is played on its own")
    if since is not None:
        context.exit(fork_run(run, since, overrides, out, as_json))
    if out is not None:
        raise click.UsageError("--out belongs to --from")
    code = replay_run(run, overrides, as_json)
    if view and code != BAD_INPUT:
        from testbed.cli.dash import play_run

        play_run(run)
    context.exit(code)
