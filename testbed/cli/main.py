"""`testbed`: the operator's command. Each verb imports what it needs when it runs.

Exit codes: 0 flown and all criteria met; 1 flown, a criterion failed; 2 bad input; 3 aborted by a
fault; 130 interrupted.
"""

import sys
from pathlib import Path

import click

OK, FAILED, BAD_INPUT, FAULT, INTERRUPTED = 0, 1, 2, 3, 130


@click.group(context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100})
@click.version_option(package_name="airbearing-testbed", prog_name="testbed")
def main() -> None:
    """Fly satellite simulators on an air-bearing table, or on its twin."""


@main.command()
@click.argument("experiment")
@click.argument("overrides", nargs=-1, metavar="[KEY=VALUE]...")
@click.option(
    "--rig", type=click.Choice(["twin"]), default="twin", show_default=True, help="What to fly on."
)
@click.option("--seed", type=click.IntRange(min=0), help="Of all chance in the twin.")
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    help="Folder of the run, new or empty.  [default: runs/<UTC time>_<name>]",
)
@click.option("--json", "as_json", is_flag=True, help="Print metrics.json and nothing else.")
@click.pass_context
def run(
    context: click.Context,
    experiment: str,
    overrides: tuple[str, ...],
    rig: str,
    seed: int | None,
    out: Path | None,
    as_json: bool,
) -> None:
    """Fly an EXPERIMENT: a file, or the name of a shipped one (see `testbed list`).

    KEY=VALUE changes a value of the file for this run; VALUE is TOML and `*` in KEY means every
    entry:

    \b
      testbed run zhang2023_table
      testbed run zhang2023_table vehicles.sat1.start=[1.2,-1.4,0.0] controller.lambda=1.2
      testbed run hold vehicles.*.model.mass=18.0 --seed 7 --out runs/heavy
    """  # noqa: D301  (a real backspace: click keeps the lines after it as they are)
    from testbed.cli.run import run_experiment

    if seed is not None:
        overrides = (*overrides, f"seed={seed}")
    context.exit(run_experiment(experiment, overrides, out, as_json))


@main.command()
@click.argument("experiment")
@click.argument("overrides", nargs=-1, metavar="[KEY=VALUE]...")
@click.pass_context
def check(context: click.Context, experiment: str, overrides: tuple[str, ...]) -> None:
    """Validate an EXPERIMENT file without flying it."""
    from testbed.cli.look import check_experiment

    context.exit(check_experiment(experiment, overrides))


@main.command(name="list")
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
def list_all(as_json: bool) -> None:
    """Show experiments, laws and vehicles, one line each."""
    from testbed.cli.look import list_everything

    list_everything(as_json)


@main.command()
@click.argument("experiment")
@click.argument("overrides", nargs=-1, metavar="[KEY=VALUE]...")
@click.option("--flights", type=click.IntRange(min=1), default=8, show_default=True)
@click.option("--force", is_flag=True, help="Ask for its name to admit it all the same.")
@click.option("--json", "as_json", is_flag=True, help="Print JSON and nothing else.")
@click.pass_context
def admit(
    context: click.Context, experiment: str, overrides: tuple[str, ...], flights: int,
    force: bool, as_json: bool,
) -> None:  # fmt: skip
    """Predict in the twin whether an EXPERIMENT may be flown on hardware."""
    from testbed.cli.admit import run_admission

    code = run_admission(experiment, overrides, flights, force=force, as_json=as_json)
    context.exit(code)


@main.command()
@click.option("--rig", type=click.Choice(["twin"]), default="twin", show_default=True)
@click.option("--injections", type=click.IntRange(min=1), default=513, show_default=True)
@click.option("--seed", type=click.IntRange(min=0), default=0, help="Of what is drawn.")
@click.option("--jobs", type=click.IntRange(min=1), default=2, show_default=True)
@click.option("--json", "as_json", is_flag=True, help="Print JSON and nothing else.")
@click.pass_context
def drill(
    context: click.Context, rig: str, injections: int, seed: int, jobs: int, as_json: bool
) -> None:
    """Rehearse the whole catalogue of faults: what is found, how soon, and what is done."""
    from testbed.cli.drill import run_drill

    context.exit(run_drill(rig, injections, seed, jobs, as_json))


@main.command()
@click.argument("kind", type=click.Choice(["experiment", "vehicle", "table"]), default="experiment")
def schema(kind: str) -> None:
    """Print the JSON Schema of an experiment, vehicle or table file, for editors."""
    from testbed.cli.look import print_schema

    print_schema(kind)


def entry() -> None:
    """Run the command as a program, with the exit codes above."""
    try:
        code = main(standalone_mode=False)
    except click.Abort:
        sys.exit(INTERRUPTED)
    except click.ClickException as error:
        error.show()
        sys.exit(BAD_INPUT)
    sys.exit(code)


if __name__ == "__main__":
    entry()
