"""Arguments of the lab verbs; the implementation is imported when a verb runs."""

from pathlib import Path

import click

from testbed.cli.keys import words


def word(context: click.Context, option: click.Parameter, given: str | None) -> str | None:
    """Validate a name that becomes part of a network key."""
    return None if given is None else words(context, option, [given])[0]


@click.command()
@click.argument("experiment")
@click.argument("overrides", nargs=-1, metavar="[KEY=VALUE]...")
@click.option(
    "--ports",
    type=click.Path(path_type=Path, exists=True, file_okay=False),
    help="Folder for the vehicles' serial ports; overrides the table file."
    "  [default: the ports in the table file]",
)
@click.option("--local", "here", is_flag=True, help="Use loopback addresses instead of the lab's.")
@click.pass_context
def twin(
    context: click.Context,
    experiment: str,
    overrides: tuple[str, ...],
    ports: Path | None,
    here: bool,
) -> None:
    """Simulate the table of an EXPERIMENT in real time.

    Serves motion capture, serial ports with the valve-board firmware, and the true states. Connect
    `testbed agent` and `testbed run --rig table` to test a lab's wiring without the lab. With
    `--local` in all of them, the table file can keep the lab's addresses.
    """
    from testbed.cli.wires import serve_twin

    context.exit(serve_twin(experiment, overrides, ports, here=here))


@click.command()
@click.argument("vehicle", callback=word)
@click.option("--connect", help="Endpoint of the host.  [default: from the keys; else loopback]")
@click.option(
    "--lab",
    callback=word,
    help="Name of the lab on the network.  [default: from the keys; else lab]",
)
@click.option("--serial", help="Serial port of the valve board.  [default: from the table file]")
@click.option(
    "--keys", type=click.Path(path_type=Path), help="The vehicle's key folder (`testbed lab-keys`)."
)
@click.pass_context
def agent(
    context: click.Context, vehicle: str, connect: str | None, lab: str | None,
    serial: str | None, keys: Path | None,
) -> None:  # fmt: skip
    """Run the agent of a VEHICLE on its on-board computer."""
    from testbed.cli.wires import fly_agent
    from testbed.rig.wired.agent_process import AgentOptions

    context.exit(fly_agent(AgentOptions(vehicle, connect, lab, serial, keys)))


@click.command()
@click.argument("experiment")
@click.argument("overrides", nargs=-1, metavar="[KEY=VALUE]...")
@click.option(
    "--for", "seconds", type=click.FloatRange(min=0.0, min_open=True),
    help="Duration [s].  [default: until Ctrl-C]",
)  # fmt: skip
@click.pass_context
def poses(
    context: click.Context, experiment: str, overrides: tuple[str, ...], seconds: float | None
) -> None:
    """Show the poses that motion capture measures for an EXPERIMENT.

    Prints each body in the table's frame with its rate and latency, and sends no commands. The
    exit code is 1 if a vehicle is not tracked.
    """
    from testbed.cli.poses import watch_poses

    context.exit(watch_poses(experiment, overrides, seconds))


@click.command()
@click.option("--connect", help="Endpoint of the host.  [default: every flight on this machine]")
@click.option(
    "--lab",
    callback=word,
    default="lab",
    show_default=True,
    help="Name of the lab on the network.",
)
@click.option(
    "--keys",
    type=click.Path(path_type=Path),
    help="The operator's key folder (`testbed lab-keys`).  [default: ~/.airbearing-testbed]",
)
@click.pass_context
def stop(context: click.Context, connect: str | None, lab: str, keys: Path | None) -> None:
    """Stop all flights: vehicles brake, then turn bearing air off.

    A second `testbed stop` closes valves and air at once.
    """
    from testbed.net.stop import stop_everything

    context.exit(stop_everything(connect, lab, keys))


@click.command()
@click.argument("experiment")
@click.argument("overrides", nargs=-1, metavar="[KEY=VALUE]...")
@click.option(
    "--rig", type=click.Choice(["twin", "bench", "table"]), default="twin", show_default=True,
    help="Where the vehicles are; table: on the computer with the valve board.",
)  # fmt: skip
@click.option("--vehicle", "only", multiple=True, help="Only this vehicle.  [default: all]")
@click.option("--yes", is_flag=True, help="Answer every question with yes; not on the table.")
@click.option("--out", type=click.Path(path_type=Path), help="Folder of the report.")
@click.option("--json", "as_json", is_flag=True, help="Print JSON and nothing else.")
@click.pass_context
def commission(
    context: click.Context, experiment: str, overrides: tuple[str, ...], rig: str,
    only: tuple[str, ...], yes: bool, out: Path | None, as_json: bool,
) -> None:  # fmt: skip
    """Find wiring errors before the vehicles of an EXPERIMENT fly.

    Each step says what will move, asks, and gives a verdict; see docs/commission.md.
    """
    from testbed.cli.commission import run_commission

    context.exit(run_commission(experiment, overrides, rig, only, out, yes=yes, as_json=as_json))
