"""`testbed`: the command line. Each verb imports its modules only when it runs.

Exit codes: 0 flown and all criteria met; 1 flown, a criterion failed; 2 bad input; 3 aborted by a
fault; 4 not started, because an arming check is red or the operator declined; 70 internal error (as
in sysexits.h); 130 interrupted, or stopped by an operator.
"""

import os
import sys
from pathlib import Path

import click

from testbed.cli.campaign_verbs import benchmark, campaign, tune
from testbed.cli.exit_code import BAD_INPUT, FAILED, INTERRUPTED
from testbed.cli.film import film
from testbed.cli.finite import finite
from testbed.cli.identify import calibrate, excite, validate
from testbed.cli.keys import lab_keys
from testbed.cli.lab import agent, commission, poses, stop, twin
from testbed.cli.replay_verb import replay
from testbed.cli.watch import console, dash, ros2

EPILOG = """\b
Exit codes:
  0  flown, all criteria met        4  not armed: a check is red
  1  flown, a criterion failed     70  internal error: please report it
  2  bad input                    130  interrupted, or stopped by an operator
  3  aborted by a fault
"""


def forget_unknown_width() -> None:
    """Remove a COLUMNS that is no width: at a width of 0 nothing would be printed."""
    columns = os.environ.get("COLUMNS", "1")
    if not columns.isdecimal() or int(columns) == 0:
        del os.environ["COLUMNS"]


@click.group(
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
    epilog=EPILOG,
)
@click.version_option(package_name="airbearing-testbed", prog_name="testbed")
def main() -> None:
    """Fly satellite simulators on an air-bearing table or its simulated twin."""
    forget_unknown_width()


@main.command()
@click.argument("experiment")
@click.argument("overrides", nargs=-1, metavar="[KEY=VALUE]...")
@click.option(
    "--rig",
    type=click.Choice(["twin", "bench", "table"]),
    default="twin",
    show_default=True,
    help="Where to fly: simulation, hardware in the loop, or the real table.",
)
@click.option("--seed", type=click.IntRange(min=0), help="Random seed of the twin.")
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    help="Run folder, new or empty.  [default: runs/<UTC time>_<name>]",
)
@click.option("--json", "as_json", is_flag=True, help="Print metrics.json and nothing else.")
@click.option("--view", "view", flag_value="window", help="Open the dashboard in a window.")
@click.option("--web", "view", flag_value="web", help="Serve the dashboard to a browser.")
@click.option(
    "--console",
    type=click.IntRange(0, 65535),
    is_flag=False,
    flag_value=0,
    metavar="[PORT]",
    help="Serve the operator's page, with its STOP.  [default port: 8765]",
)
@click.option("--bind", help="Network address of what is served.  [default: 127.0.0.1]")
@click.option(
    "--port", type=click.IntRange(1, 65534),
    help="Data port of the dashboard; the page uses PORT+1.  [default: free ports]",
)  # fmt: skip
@click.option(
    "--speed",
    type=click.FloatRange(min=0.0, min_open=True),
    callback=finite,
    help="Multiple of real time.  [default: as fast as possible; 1 with a page]",
)
@click.option("--arm", is_flag=True, help="On the table: arm without asking (for scripts).")
@click.option(
    "--reset",
    is_flag=True,
    help="Reset the latched fault; confirms that you inspected the vehicles.",
)
@click.option(
    "--local", "here", is_flag=True,
    help="With --rig table: use loopback addresses, for `testbed twin --local`.",
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
    console: int | None,
    bind: str | None,
    port: int | None,
    speed: float | None,
    arm: bool,
    reset: bool,
    here: bool,
) -> None:
    """Fly an EXPERIMENT and check its criteria.

    EXPERIMENT is a file or the name of a shipped experiment (see `testbed list`). KEY=VALUE
    overrides a value of the file for this run; VALUE is TOML, and `*` in KEY matches every entry:

    \b
      testbed run zhang2023_table
      testbed run zhang2023_table vehicles.sat1.start=[1.2,-1.4,0.0]
      testbed run hold 'vehicles.*.model.mass=18.0' --seed 7 --out runs/heavy
    """  # noqa: D301  (\b is a backspace: click does not rewrap the lines after it)
    from testbed.net.flight_note import noted
    from testbed.realtime.heartbeat import process_to_end

    if seed is not None:
        overrides = (*overrides, f"seed={seed}")
    name, pid = Path(experiment).stem, process_to_end()
    with noted("", "", name=name, pid=pid, warn=lambda text: None, rig=rig):
        # slow imports, and `testbed stop` must find the run
        from testbed.cli.run import RunOptions, run_experiment

        options = RunOptions(
            rig, out, as_json, view, console, bind, port, speed, arm=arm, reset=reset, here=here
        )
        code = run_experiment(experiment, overrides, options)
    context.exit(code)


@main.command()
@click.argument("experiment")
@click.argument("overrides", nargs=-1, metavar="[KEY=VALUE]...")
@click.option("--faults", is_flag=True, help="Print the fault table and how its bounds follow.")
@click.option("--defaults", is_flag=True, help="Print gains and limits that fit, and their source.")
@click.pass_context
def check(
    context: click.Context, experiment: str, overrides: tuple[str, ...], faults: bool,
    defaults: bool,
) -> None:  # fmt: skip
    """Validate an EXPERIMENT file without flying it."""
    from testbed.cli.inspection import check_experiment

    context.exit(check_experiment(experiment, overrides, faults=faults, defaults=defaults))


@main.command(name="list")
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
def list_all(as_json: bool) -> None:
    """List experiments, laws, vehicles, tables, scenarios."""
    from testbed.cli.inspection import list_everything

    list_everything(as_json)


@main.command()
@click.argument("experiment")
@click.argument("overrides", nargs=-1, metavar="[KEY=VALUE]...")
@click.option(
    "--flights", type=click.IntRange(min=1), default=8, show_default=True,
    help="Number of flights, each with another seed.",
)  # fmt: skip
@click.option("--force", is_flag=True, help="Override a refusal; asks for the experiment's name.")
@click.option("--json", "as_json", is_flag=True, help="Print JSON and nothing else.")
@click.pass_context
def admit(
    context: click.Context, experiment: str, overrides: tuple[str, ...], flights: int,
    force: bool, as_json: bool,
) -> None:  # fmt: skip
    """Predict in the twin whether an EXPERIMENT can fly on hardware."""
    from testbed.cli.admit import run_admission

    code = run_admission(experiment, overrides, flights, force=force, as_json=as_json)
    context.exit(code)


@main.command()
@click.argument("experiment", required=False)
@click.option(
    "--rig", type=click.Choice(["twin", "bench"]), default="twin", show_default=True,
    help="Where to inject the faults.",
)  # fmt: skip
@click.option(
    "--injections",
    type=click.IntRange(min=1),
    help="Number of faults.  [default: 540, or one of each kind on the bench]",
)
@click.option("--seed", type=click.IntRange(min=0), default=0, help="Seed of the random cases.")
@click.option(
    "--jobs", type=click.IntRange(min=1), default=2, show_default=True,
    help="Worker processes on this machine.",
)  # fmt: skip
@click.option("--json", "as_json", is_flag=True, help="Print JSON and nothing else.")
@click.pass_context
def drill(
    context: click.Context, experiment: str | None, rig: str, injections: int | None, seed: int,
    jobs: int, as_json: bool,
) -> None:  # fmt: skip
    """Inject every kind of fault and report the response.

    Flies EXPERIMENT, for instance with a lab's own vehicle, or two shipped ones. Prints for each
    kind whether it was detected, how fast, and which response followed; see docs/faults.md.
    """
    from testbed.cli.drill import run_drill

    context.exit(run_drill(rig, injections, seed, jobs, as_json, experiment))


@main.command()
@click.argument("kind", type=click.Choice(["experiment", "vehicle", "table"]), default="experiment")
def schema(kind: str) -> None:
    """Print the JSON Schema of a file type, for editors."""
    from testbed.cli.inspection import print_schema

    print_schema(kind)


@main.command()
@click.argument("run", type=click.Path(exists=True, path_type=Path))
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
@click.pass_context
def log(context: click.Context, run: Path, as_json: bool) -> None:
    """List the topics of a RUN's log, with rates and gaps."""
    from testbed.cli.log import show_log

    context.exit(show_log(run, as_json))


@main.command()
@click.argument("run", type=click.Path(exists=True, path_type=Path))
@click.option(
    "--to", "kind", type=click.Choice(["parquet", "csv", "mat", "npz", "bag", "rrd"]),
    required=True,
    help="Output format.",
)  # fmt: skip
@click.option(
    "--out", type=click.Path(path_type=Path), help="Output folder.  [default: RUN/export]"
)
@click.pass_context
def export(context: click.Context, run: Path, kind: str, out: Path | None) -> None:
    """Export the log of a RUN: tables, ROS 2 bag, rerun recording."""
    from testbed.cli.log import export_run

    context.exit(export_run(run, kind, out))


@main.command()
@click.argument("run", type=click.Path(exists=True, file_okay=False, path_type=Path))
@click.option("--png", is_flag=True, help="Also write figures/*.png, 2400 pixels wide.")
@click.pass_context
def report(context: click.Context, run: Path, png: bool) -> None:
    """Regenerate report.html and figures/*.svg of a RUN folder."""
    from testbed.cli.report import report_run

    context.exit(report_run(run, png))


@main.command()
@click.argument(
    "runs", nargs=-1, required=True, type=click.Path(exists=True, file_okay=False, path_type=Path)
)
@click.option(
    "--out", type=click.Path(path_type=Path), help="Also write an HTML page with figures."
)
@click.option(
    "--paper", is_flag=True, help="Also what the paper prints about the first run's experiment."
)
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
@click.pass_context
def compare(
    context: click.Context, runs: tuple[Path, ...], out: Path | None, paper: bool, as_json: bool
) -> None:
    """Compare RUNS side by side: laws, seeds, or twin and table."""
    from testbed.cli.compare import compare_runs

    context.exit(compare_runs(runs, out, as_json, paper))


@main.command()
@click.argument("key")
@click.option("--quick", is_flag=True, help="Fewer seeds and coarser steps.")
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
@click.option("--markdown", "as_markdown", is_flag=True, help="Print the page for docs/.")
@click.option(
    "--plots",
    type=click.Path(path_type=Path),
    help="Folder for the figures, as SVG.",
)
@click.option(
    "--pages",
    type=click.Path(path_type=Path),
    help="Folder for web pages: an index, and a page per claim.",
)
@click.pass_context
def reproduce(
    context: click.Context,
    key: str,
    quick: bool,
    as_json: bool,
    as_markdown: bool,
    plots: Path | None,
    pages: Path | None,
) -> None:
    """Repeat a paper's simulations and check its claims.

    KEY is a paper (gao2022, xue2021, xue2022, xue2024, zhang2023) or all. The exit code is 1 if a
    verdict differs from the one in configs/papers.
    """
    from testbed.cli.reproduce import reproduce_papers

    code = reproduce_papers(
        key, quick=quick, as_json=as_json, as_markdown=as_markdown, plots=plots, pages=pages
    )
    context.exit(code)


for verb in (
    agent, benchmark, calibrate, campaign, commission, console, dash, excite, film, lab_keys, poses,
    replay, ros2, stop, tune, twin, validate,
):  # fmt: skip
    main.add_command(verb)


def _say_no_more(code: int) -> int:
    """Redirect standard output to /dev/null, so that the flush at exit does not fail again."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
    return code


def entry() -> None:
    """Run the command as a program, with the exit codes above."""
    try:
        code = main(standalone_mode=False, prog_name="testbed")
        sys.stdout.flush()  # here, where an error can still be reported
    except click.Abort:
        sys.exit(INTERRUPTED)
    except click.ClickException as error:
        error.show()
        sys.exit(BAD_INPUT)
    except BrokenPipeError:  # the reader of the pipe has ended; click also exits with 1
        code = _say_no_more(FAILED)
    except OSError as error:  # such as a full disk behind standard output
        from testbed.cli.refusal import refuse

        code = _say_no_more(refuse(error))
    # Errors in files, connections and laws are handled above, so this is a bug, of any class: it
    # gets its traceback and exit code 70.
    except Exception:
        from testbed.cli.refusal import print_internal_error

        code = print_internal_error()
    sys.exit(code)
