"""`testbed`: the operator's command. Each verb imports what it needs when it runs.

Exit codes: 0 flown and all criteria met; 1 flown, a criterion failed; 2 bad input; 3 aborted by a
fault; 4 not started, because an arming check is red or the operator did not agree; 70 this software
has failed (as in sysexits.h); 130 interrupted.
"""

import os
import sys
from pathlib import Path

import click

from testbed.cli.exit_code import BAD_INPUT, FAILED, INTERRUPTED
from testbed.cli.keys import lab_keys
from testbed.cli.lab import agent, poses, stop, twin
from testbed.cli.many import bench, campaign, tune

EPILOG = """\b
Exit codes:
  0  flown, all criteria met        4  not armed: a check is red
  1  flown, a criterion failed     70  this software has failed
  2  bad input                    130  interrupted
  3  aborted by a fault
"""


@click.group(
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
    epilog=EPILOG,
)
@click.version_option(package_name="airbearing-testbed", prog_name="testbed")
def main() -> None:
    """Fly satellite simulators on an air-bearing table, or on its twin."""


@main.command()
@click.argument("experiment")
@click.argument("overrides", nargs=-1, metavar="[KEY=VALUE]...")
@click.option(
    "--rig",
    type=click.Choice(["twin", "bench", "table"]),
    default="twin",
    show_default=True,
    help="What to fly on.",
)
@click.option("--seed", type=click.IntRange(min=0), help="Of all chance in the twin.")
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    help="Folder of the run, new or empty.  [default: runs/<UTC time>_<name>]",
)
@click.option("--json", "as_json", is_flag=True, help="Print metrics.json and nothing else.")
@click.option("--view", "view", flag_value="window", help="Open the dashboard in a window.")
@click.option("--web", "view", flag_value="web", help="Open the dashboard for a browser.")
@click.option("--bind", help="Who may connect to the dashboard.  [default: 127.0.0.1]")
@click.option(
    "--port", type=click.IntRange(1, 65534),
    help="Of the dashboard's data; the page is one above.  [default: two free ones]",
)  # fmt: skip
@click.option(
    "--speed",
    type=click.FloatRange(min=0.0, min_open=True),
    help="Times real time.  [default: as fast as it goes; 1 with --view or --web]",
)
@click.option("--arm", is_flag=True, help="On the table: arm without asking, for scripts.")
@click.option("--reset", is_flag=True, help="After a fault: I have looked at the vehicles.")
@click.option(
    "--local", "here", is_flag=True,
    help="With --rig table and `testbed twin --local`: this machine's addresses, not the lab's.",
)  # fmt: skip
@click.pass_context
def run(
    context: click.Context,
    experiment: str,
    overrides: tuple[str, ...],
    rig: str,
    seed: int | None,
    out: Path | None,
    as_json: bool,
    view: str | None,
    bind: str | None,
    port: int | None,
    speed: float | None,
    arm: bool,
    reset: bool,
    here: bool,
) -> None:
    """Fly an EXPERIMENT and judge it.

    EXPERIMENT is a file, or the name of a shipped one (see `testbed list`). KEY=VALUE changes a
    value of the file for this run; VALUE is TOML and `*` in KEY means every entry:

    \b
      testbed run zhang2023_table
      testbed run zhang2023_table vehicles.sat1.start=[1.2,-1.4,0.0]
      testbed run hold 'vehicles.*.model.mass=18.0' --seed 7 --out runs/heavy
    """  # noqa: D301  (a real backspace: click keeps the lines after it as they are)
    from testbed.cli.run import run_experiment

    if seed is not None:
        overrides = (*overrides, f"seed={seed}")
    context.exit(
        run_experiment(
            experiment,
            overrides,
            out,
            as_json,
            rig,
            view,
            speed,
            arm=arm,
            reset=reset,
            here=here,
            bind=bind,
            port=port,
        )
    )


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
@click.option(
    "--flights", type=click.IntRange(min=1), default=8, show_default=True,
    help="How many, each with other chance.",
)  # fmt: skip
@click.option("--force", is_flag=True, help="Ask for its name to admit it all the same.")
@click.option("--json", "as_json", is_flag=True, help="Print JSON and nothing else.")
@click.pass_context
def admit(
    context: click.Context, experiment: str, overrides: tuple[str, ...], flights: int,
    force: bool, as_json: bool,
) -> None:  # fmt: skip
    """Predict in the twin whether an EXPERIMENT may fly on hardware."""
    from testbed.cli.admit import run_admission

    code = run_admission(experiment, overrides, flights, force=force, as_json=as_json)
    context.exit(code)


@main.command()
@click.option(
    "--rig",
    type=click.Choice(["twin", "bench"]),
    default="twin",
    show_default=True,
    help="What to rehearse on.",
)
@click.option(
    "--injections",
    type=click.IntRange(min=1),
    help="How many faults.  [default: 513, or 72 on the bench]",
)
@click.option("--seed", type=click.IntRange(min=0), default=0, help="Of what is drawn.")
@click.option(
    "--jobs", type=click.IntRange(min=1), default=2, show_default=True,
    help="Processes on this machine.",
)  # fmt: skip
@click.option("--json", "as_json", is_flag=True, help="Print JSON and nothing else.")
@click.pass_context
def drill(
    context: click.Context, rig: str, injections: int | None, seed: int, jobs: int, as_json: bool
) -> None:
    """Rehearse the whole catalogue of faults (docs/safety.md).

    Says of each fault whether it is found, how soon, and what is done about it.
    """
    from testbed.cli.drill import run_drill

    context.exit(run_drill(rig, injections, seed, jobs, as_json))


@main.command()
@click.argument("kind", type=click.Choice(["experiment", "vehicle", "table"]), default="experiment")
def schema(kind: str) -> None:
    """Print the JSON Schema of a kind of file, for editors."""
    from testbed.cli.look import print_schema

    print_schema(kind)


@main.command()
@click.argument("run", type=click.Path(exists=True, path_type=Path))
@click.argument("overrides", nargs=-1, metavar="[KEY=VALUE]...")
@click.option("--json", "as_json", is_flag=True, help="Print JSON and nothing else.")
@click.option("--view", is_flag=True, help="Play it in the dashboard afterwards.")
@click.pass_context
def replay(
    context: click.Context, run: Path, overrides: tuple[str, ...], as_json: bool, view: bool
) -> None:
    """Feed the log of a RUN folder to today's code.

    The exit code is 1 if it does anything else than the log says.
    """
    from testbed.cli.replay import replay_run

    code = replay_run(run, overrides, as_json)
    if view and code != BAD_INPUT:
        from testbed.cli.dash import play_run

        play_run(run)
    context.exit(code)


@main.command()
@click.argument("run", type=click.Path(exists=True, path_type=Path))
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
@click.pass_context
def log(context: click.Context, run: Path, as_json: bool) -> None:
    """Show the topics of a RUN's log, their rates and gaps."""
    from testbed.cli.log import show_log

    context.exit(show_log(run, as_json))


@main.command()
@click.argument("run", type=click.Path(exists=True, path_type=Path))
@click.option(
    "--to", "kind", type=click.Choice(["parquet", "csv", "npz", "rrd"]), required=True,
    help="What to write.",
)  # fmt: skip
@click.option("--out", type=click.Path(path_type=Path), help="Folder.  [default: RUN/export]")
@click.pass_context
def export(context: click.Context, run: Path, kind: str, out: Path | None) -> None:
    """Write the log of a RUN as tables, or for the rerun viewer."""
    from testbed.cli.log import export_run

    context.exit(export_run(run, kind, out))


@main.command()
@click.argument("run", type=click.Path(exists=True, file_okay=False, path_type=Path))
@click.option("--png", is_flag=True, help="Also figures/*.png, 2400 pixels wide.")
@click.pass_context
def report(context: click.Context, run: Path, png: bool) -> None:
    """Make report.html and figures/*.svg of a RUN folder again."""
    from testbed.cli.report import report_run

    context.exit(report_run(run, png))


@main.command()
@click.argument(
    "runs", nargs=-1, required=True, type=click.Path(exists=True, file_okay=False, path_type=Path)
)
@click.option("--out", type=click.Path(path_type=Path), help="Write figures to this HTML file.")
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
@click.pass_context
def compare(
    context: click.Context, runs: tuple[Path, ...], out: Path | None, as_json: bool
) -> None:
    """Lay RUNS side by side: laws, seeds, the twin against the table."""
    from testbed.cli.compare import compare_runs

    context.exit(compare_runs(runs, out, as_json))


@main.command()
@click.argument("run", type=click.Path(exists=True, file_okay=False, path_type=Path))
@click.option("--web", is_flag=True, help="In the browser instead of a window.")
@click.option("--bind", default="127.0.0.1", show_default=True, help="Who may connect.")
@click.option("--port", type=click.IntRange(1, 65534), help="Of the data; the page is one above.")
@click.pass_context
def dash(context: click.Context, run: Path, web: bool, bind: str, port: int | None) -> None:
    """Open the dashboard on a RUN folder, flown now or long ago."""
    from testbed.cli.dash import show_run

    context.exit(show_run(run, "web" if web else "window", bind, port))


@main.command()
@click.argument("key")
@click.option("--quick", is_flag=True, help="Fewer seeds and coarser steps.")
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
@click.option("--markdown", "as_markdown", is_flag=True, help="Print the page of the docs.")
@click.option("--plots", type=click.Path(path_type=Path), help="Folder for redrawn figures.")
@click.pass_context
def reproduce(
    context: click.Context,
    key: str,
    quick: bool,
    as_json: bool,
    as_markdown: bool,
    plots: Path | None,
) -> None:
    """Say which claims of a paper hold: its simulations, again.

    KEY is a paper (gao2022, xue2021, xue2022, xue2024, zhang2023) or all. The exit code is 1 if a
    verdict is not the one that configs/papers expects.
    """
    from testbed.cli.reproduce import reproduce_papers

    context.exit(
        reproduce_papers(key, quick=quick, as_json=as_json, as_markdown=as_markdown, plots=plots)
    )


for verb in (agent, bench, campaign, lab_keys, poses, stop, tune, twin):
    main.add_command(verb)


def _say_no_more(code: int) -> int:
    """Let go of standard output, or Python would fail at its end once more."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
    return code


def entry() -> None:
    """Run the command as a program, with the exit codes above."""
    try:
        code = main(standalone_mode=False)
        sys.stdout.flush()  # here, and not when nobody can say any more what is wrong
    except click.Abort:
        sys.exit(INTERRUPTED)
    except click.ClickException as error:
        error.show()
        sys.exit(BAD_INPUT)
    except BrokenPipeError:  # nobody reads any more; click says 1, too
        code = _say_no_more(FAILED)
    except OSError as error:  # such as a full disk behind standard output
        from testbed.cli.refusal import refuse

        code = _say_no_more(refuse(error))
    except Exception:  # none of what can be wrong with files, wires or laws: those are refused
        from testbed.cli.refusal import confess

        code = confess()
    sys.exit(code)
