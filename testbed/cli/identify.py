"""Arguments of `calibrate`, `validate` and `excite`; the work is imported when a verb runs."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import click

from testbed.cli.flight_logs import FlightLogs

LOG = click.Path(exists=True, dir_okay=False, path_type=Path)
FLIGHT = click.Path(exists=True, path_type=Path)  # also a run folder
OUT = click.Path(path_type=Path, dir_okay=False)


def of_flights(command: Callable[..., Any]) -> Callable[..., Any]:
    """Arguments of the verbs that read logs of flights."""
    for option in (
        click.option("--json", "as_json", is_flag=True, help="Print JSON and nothing else."),
        click.option("--until", type=float, help="Use only rows before this time [s]."),
        click.option("--from", "since", type=float, help="Use only rows from this time on [s]."),
        click.option("--vehicle", required=True, help="Vehicle file, or name of a shipped one."),
        click.option("--body", help="Which vehicle of a run folder.  [default: the only one]"),
        click.option(
            "--mapping", help="Mapping file, or name of a shipped one; a run folder needs none."
        ),
        click.argument("logs", nargs=-1, required=True, type=FLIGHT),
    ):
        command = option(command)
    return command


@click.group()
def calibrate() -> None:
    """Fit a vehicle, a table or cameras to logs (docs/calibrate.md)."""


@calibrate.command()
@of_flights
@click.option("--out", type=OUT, help="Write the fitted vehicle to this file.")
@click.option("--table-out", type=OUT, help="Write a table with the fitted slope to this file.")
@click.option("--force", is_flag=True, help="Fit in spite of a suspicion.")
@click.pass_context
def motion(
    context: click.Context, logs: tuple[Path, ...], mapping: str | None, body: str | None,
    vehicle: str, since: float | None, until: float | None, as_json: bool, out: Path | None,
    force: bool, table_out: Path | None,
) -> None:  # fmt: skip
    """Fit a vehicle to LOGS of free flight."""
    from testbed.cli import calibrate as work

    context.exit(
        work.motion(
            FlightLogs(logs, mapping, body, since, until),
            vehicle,
            out,
            table_out,
            force=force,
            as_json=as_json,
        )
    )


@calibrate.command()
@of_flights
@click.option("--table", help="Table file to start from, or name of a shipped one.")
@click.option("--size", nargs=2, type=float, help="Size of the table [m].")
@click.option("--nodes", type=click.IntRange(3, 21), default=9, show_default=True)
@click.option("--out", type=OUT, help="Write the table with its slope map to this file.")
@click.option("--vehicle-out", type=OUT, help="Write the vehicle that was fitted with it.")
@click.option("--page", type=OUT, help="Write an HTML page with the map.")
@click.option("--force", is_flag=True, help="Fit in spite of a suspicion.")
@click.pass_context
def floor(
    context: click.Context, logs: tuple[Path, ...], mapping: str | None, body: str | None,
    vehicle: str, since: float | None, until: float | None, as_json: bool, table: str | None,
    size: tuple[float, float] | None, nodes: int, out: Path | None, vehicle_out: Path | None,
    page: Path | None, force: bool,
) -> None:  # fmt: skip
    """Learn the slope map of a table from LOGS of flights."""
    from testbed.cli import learn_floor as work

    context.exit(
        work.floor(
            FlightLogs(logs, mapping, body, since, until), vehicle, table, size, nodes, out,
            vehicle_out, page, force=force, as_json=as_json,
        )
    )  # fmt: skip


@calibrate.command()
@click.argument("log", type=LOG)
@click.option("--x", default="x_m", show_default=True, help="Column of x [m].")
@click.option("--y", default="y_m", show_default=True, help="Column of y [m].")
@click.option("--ax", default="ax_m_s2", show_default=True, help="Column of the slope along x.")
@click.option("--ay", default="ay_m_s2", show_default=True, help="Column of the slope along y.")
@click.option("--unit", type=click.Choice(["m/s^2", "mm/s^2", "rad"]), default="m/s^2",
              show_default=True, help="Of the slopes.")  # fmt: skip
@click.option("--out", type=OUT, help="Write the table with this map to this file.")
@click.option("--page", type=OUT, help="Write an HTML page with the map.")
@click.option("--json", "as_json", is_flag=True, help="Print JSON and nothing else.")
@click.pass_context
def slope(
    context: click.Context, log: Path, x: str, y: str, ax: str, ay: str, unit: str,
    out: Path | None, page: Path | None, as_json: bool,
) -> None:  # fmt: skip
    """Read a slope map that was measured, a CSV with a row per node."""
    from testbed.cli import calibrate as work

    context.exit(work.slope(log, (x, y, ax, ay), unit, out, page, as_json=as_json))


@calibrate.command()
@click.argument("logs", nargs=-1, required=True, type=LOG)
@click.option("--time", default="t_s", show_default=True, help="Column of time [s].")
@click.option("--force-column", default="weight_g", show_default=True, help="Column of the scale.")
@click.option("--unit", type=click.Choice(["g", "N"]), default="g", show_default=True)
@click.option("--pulse", default="bitmask", show_default=True, help="Column above 0 while on.")
@click.option("--json", "as_json", is_flag=True, help="Print JSON and nothing else.")
@click.pass_context
def thrust(
    context: click.Context, logs: tuple[Path, ...], time: str, force_column: str, unit: str,
    pulse: str, as_json: bool,
) -> None:  # fmt: skip
    """Thrust of a jet from LOGS of a thrust stand."""
    from testbed.cli import calibrate as work

    context.exit(work.thrust(logs, (time, force_column, pulse), unit, as_json))


@calibrate.command()
@click.argument("log", type=click.Path(exists=True, path_type=Path))
@click.option("--time", default="t_s", show_default=True, help="Column of time [s].")
@click.option("--value", default="angle_deg", show_default=True, help="Column of the angle.")
@click.option("--source", default="source", show_default=True, help="Column of the source's name.")
@click.option("--camera", default="camera", show_default=True, help="Name of the camera there.")
@click.option("--mapping", help="Noise, axes and body offset from a flight: its mapping.")
@click.option("--body", help="Which vehicle of a run folder.  [default: the only one]")
@click.option("--vehicle", help="The vehicle of that flight.")
@click.option("--force", is_flag=True, help="Measure in spite of a suspicion about that flight.")
@click.option("--json", "as_json", is_flag=True, help="Print JSON and nothing else.")
@click.pass_context
def mocap(
    context: click.Context, log: Path, time: str, value: str, source: str, camera: str,
    mapping: str | None, body: str | None, vehicle: str | None, as_json: bool, force: bool,
) -> None:  # fmt: skip
    """Measure the cameras.

    Latency from a marker on a known angle; or noise, axes and offset of the body from a flight,
    which is a run folder, or a log with its --mapping.
    """
    from testbed.cli import calibrate as work

    columns = (source, time, value)
    context.exit(work.mocap(
        log, mapping, body, vehicle, columns, camera, force=force, as_json=as_json,
    ))  # fmt: skip


@calibrate.command()
@click.argument("log", type=LOG)
@click.option("--sent", default="sent_s", show_default=True, help="Column of the sending time [s].")
@click.option("--received", default="received_s", show_default=True, help="Column of the arrival.")
@click.option("--json", "as_json", is_flag=True, help="Print JSON and nothing else.")
@click.pass_context
def link(context: click.Context, log: Path, sent: str, received: str, as_json: bool) -> None:
    """Delay, jitter and loss of a link from a LOG of messages."""
    from testbed.cli import calibrate as work

    context.exit(work.link(log, (sent, received), as_json))


@click.command()
@of_flights
@click.option("--against", help="Compare with this vehicle file, or name of a shipped one.")
@click.option(
    "--table", help="Table file with a slope map; the compared file flies on a level one."
)
@click.option("--out", type=OUT, help="Also write an HTML page with figures.")
@click.pass_context
def validate(
    context: click.Context, logs: tuple[Path, ...], mapping: str | None, body: str | None,
    vehicle: str, since: float | None, until: float | None, as_json: bool, against: str | None,
    table: str | None, out: Path | None,
) -> None:  # fmt: skip
    """Measure the twin's errors 1, 3 and 5 s ahead, on LOGS."""
    from testbed.cli import calibrate as work

    context.exit(
        work.check_against(
            FlightLogs(logs, mapping, body, since, until),
            vehicle,
            against,
            table,
            out,
            as_json=as_json,
        )
    )


@click.command()
@click.option("--vehicle", required=True, help="Vehicle file, or name of a shipped one.")
@click.option("--table", default="marble_6m", show_default=True, help="Table file or name.")
@click.option("--seconds", type=click.FloatRange(10.0, 600.0), default=120.0, show_default=True,
              help="Duration of the commands [s].")  # fmt: skip
@click.option("--room", type=click.FloatRange(min=0.1), default=1.5, show_default=True,
              help="Distance from the start that it may use [m].")  # fmt: skip
@click.option("--gas", type=click.FloatRange(min=0.0, min_open=True),
              help="Gas that it may use [g].  [default: half a tank]")  # fmt: skip
@click.option("--period", type=click.FloatRange(0.02, 1.0), default=0.1, show_default=True,
              help="Period of the valve commands [s].")  # fmt: skip
@click.option("--seed", type=click.IntRange(min=0), default=0, show_default=True,
              help="Random seed of the commands.")  # fmt: skip
@click.option("--out", type=OUT, help="Write the commands to this CSV file.")
@click.option("--json", "as_json", is_flag=True, help="Print JSON and nothing else.")
@click.pass_context
def excite(
    context: click.Context, vehicle: str, table: str, seconds: float, room: float,
    gas: float | None, period: float, seed: int, out: Path | None, as_json: bool,
) -> None:  # fmt: skip
    """Design valve commands that tell most about a vehicle."""
    from testbed.cli import calibrate as work

    context.exit(
        work.excite(vehicle, table, seconds, room, gas, period, seed, out, as_json=as_json)
    )
