"""Verbs that show a run elsewhere: `dash`, `console`, `ros2`."""

from pathlib import Path

import click

from testbed.cli.finite import finite


@click.command()
@click.argument("run", type=click.Path(exists=True, file_okay=False, path_type=Path))
@click.option("--web", is_flag=True, help="Serve to a browser instead of a window.")
@click.option("--bind", default="127.0.0.1", show_default=True, help="Network address.")
@click.option("--port", type=click.IntRange(1, 65534), help="Data port; the page uses PORT+1.")
@click.pass_context
def dash(context: click.Context, run: Path, web: bool, bind: str, port: int | None) -> None:
    """Open the dashboard for a RUN folder, live or recorded."""
    from testbed.cli.dash import show_run

    context.exit(show_run(run, "web" if web else "window", bind, port))


@click.command()
@click.argument("run", type=click.Path(exists=True, file_okay=False, path_type=Path))
@click.option(
    "--connect", "endpoint", default="tcp/127.0.0.1:7447", show_default=True, metavar="ENDPOINT",
    help="Router of ROS 2 (rmw_zenohd).",
)  # fmt: skip
@click.option(
    "--domain", type=click.IntRange(0, 232), default=0, envvar="ROS_DOMAIN_ID", show_default=True,
    help="Domain of ROS 2.",
)  # fmt: skip
@click.option(
    "--speed", type=click.FloatRange(min=0.0, min_open=True), callback=finite, default=1.0,
    show_default=True,
    help="Multiple of real time.",
)  # fmt: skip
@click.pass_context
def ros2(context: click.Context, run: Path, endpoint: str, domain: int, speed: float) -> None:
    """Publish a RUN folder to ROS 2, which must use rmw_zenoh.

    A flight is published live if its table file has ros2 = true in [lab.network].
    """
    from testbed.cli.ros2 import publish_run

    context.exit(publish_run(run, endpoint, domain, speed))


@click.command()
@click.argument(
    "run", type=click.Path(exists=True, file_okay=False, path_type=Path), required=False
)
@click.option("--bind", default="127.0.0.1", show_default=True, help="Network address.")
@click.option("--port", type=click.IntRange(1, 65535), help="Port of the page.  [default: 8765]")
@click.pass_context
def console(context: click.Context, run: Path | None, bind: str, port: int | None) -> None:
    """Serve the operator's page of a RUN folder.

    Without RUN: of the flight on this machine.
    """
    from testbed.cli.console import show_page

    context.exit(show_page(run, bind, port))
