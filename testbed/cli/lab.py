"""The verbs of a lab: their arguments. What they do is imported when it is needed."""

from pathlib import Path

import click

from testbed.cli.keys import words


def word(context: click.Context, option: click.Parameter, given: str | None) -> str | None:
    """A name that can be part of a key of the network."""
    return None if given is None else words(context, option, [given])[0]


@click.command()
@click.argument("experiment")
@click.argument("overrides", nargs=-1, metavar="[KEY=VALUE]...")
@click.option(
    "--ports",
    type=click.Path(path_type=Path, exists=True, file_okay=False),
    help="Folder in which the vehicles' serial ports appear, whatever the table file says."
    "  [default: as the table file says; here]",
)
@click.option("--local", "here", is_flag=True, help="This machine's addresses, not the lab's.")
@click.pass_context
def twin(
    context: click.Context,
    experiment: str,
    overrides: tuple[str, ...],
    ports: Path | None,
    here: bool,
) -> None:
    """Serve the table of an EXPERIMENT in real time.

    It has cameras, serial ports with firmware behind them, and the truth, for `testbed agent` and
    `testbed run --rig table` to try a lab's wiring without a lab. With `--local` here and there the
    table file may name the lab's own addresses already.
    """
    from testbed.cli.wires import serve_twin

    context.exit(serve_twin(experiment, overrides, ports, here=here))


@click.command()
@click.argument("vehicle", callback=word)
@click.option("--connect", help="Where the host listens.  [default: as the keys say; loopback]")
@click.option(
    "--lab", callback=word, help="First part of all keys.  [default: as the keys say; lab]"
)
@click.option("--serial", help="The board's port.  [default: the table file's]")
@click.option("--keys", type=click.Path(path_type=Path), help="Its folder of `testbed lab-keys`.")
@click.pass_context
def agent(
    context: click.Context, vehicle: str, connect: str | None, lab: str | None,
    serial: str | None, keys: Path | None,
) -> None:  # fmt: skip
    """Fly a VEHICLE: on its own computer, beside its valve board."""
    from testbed.cli.wires import fly_agent
    from testbed.rig.wired.agent_process import Agent

    context.exit(fly_agent(Agent(vehicle, connect, lab, serial, keys)))


@click.command()
@click.argument("experiment")
@click.argument("overrides", nargs=-1, metavar="[KEY=VALUE]...")
@click.option(
    "--for", "seconds", type=click.FloatRange(min=0.0, min_open=True),
    help="How long to look [s].  [default: until Ctrl-C]",
)  # fmt: skip
@click.pass_context
def poses(
    context: click.Context, experiment: str, overrides: tuple[str, ...], seconds: float | None
) -> None:
    """Show where the cameras see the bodies of an EXPERIMENT.

    In the table's frame, with rates and latencies; nothing is commanded. The exit code is 1 if one
    of its vehicles is not seen.
    """
    from testbed.cli.poses import watch_poses

    context.exit(watch_poses(experiment, overrides, seconds))


@click.command()
@click.option("--connect", help="Where the host listens.  [default: every flight on this machine]")
@click.option(
    "--lab", callback=word, default="lab", show_default=True, help="First part of all keys."
)
@click.option(
    "--keys",
    type=click.Path(path_type=Path),
    help="The operator's folder of `testbed lab-keys`.  [default: ~/.airbearing-testbed]",
)
@click.pass_context
def stop(context: click.Context, connect: str | None, lab: str, keys: Path | None) -> None:
    """Stop whatever flies: the vehicles brake, and at rest shut their air off.

    Said again, they shut valves and air at once.
    """
    from testbed.net.stop import stop_everything

    context.exit(stop_everything(connect, lab, keys))
