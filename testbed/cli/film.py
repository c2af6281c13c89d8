"""`testbed film`: a GIF or MP4 of a run."""

from pathlib import Path

import click

from testbed.cli.finite import finite


@click.command()
@click.argument("run", type=click.Path(exists=True, file_okay=False, path_type=Path))
@click.option(
    "--out", type=click.Path(dir_okay=False, path_type=Path),
    help="File, *.gif or *.mp4.  [default: in RUN; MP4 if ffmpeg is installed]",
)  # fmt: skip
@click.option(
    "--speed", type=click.FloatRange(min=0.0, min_open=True), callback=finite,
    help="Multiple of real time.  [default: at most 30 s of film]",
)  # fmt: skip
@click.option(
    "--width", type=click.IntRange(200, 4000), default=720, show_default=True, help="In pixels."
)
@click.option(
    "--video", type=click.Path(exists=True, dir_okay=False, path_type=Path),
    help="A camera's video, shown beside the film at the same times.",
)  # fmt: skip
@click.option(
    "--offset", type=float, default=0.0, show_default=True,
    help="Time of the run at which the video begins, in seconds; negative: before the run.",
)  # fmt: skip
@click.pass_context
def film(
    context: click.Context, run: Path, out: Path | None, speed: float | None, width: int,
    video: Path | None, offset: float,
) -> None:  # fmt: skip
    """Make a film of a RUN: vehicles, plumes, trails, events."""
    from testbed.cli.exit_code import OK
    from testbed.cli.refusal import refuse, warn
    from testbed.cli.tracked import tracked
    from testbed.core.error import TestbedError
    from testbed.run.film import make_film

    try:
        path = make_film(
            run, out, speed, width, warn, video, offset,
            watch=lambda frames, count: tracked(frames, "drawing the film", count),
        )  # fmt: skip
    except (TestbedError, OSError) as error:
        context.exit(refuse(error))
    click.echo(str(path))
    context.exit(OK)
