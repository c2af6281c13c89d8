"""Warns about implausible numbers around a vehicle: cameras, radio, criteria, battery.

Only `testbed check` prints these, like those of `plausibility`.
"""

from collections.abc import Iterator
from typing import Any

from testbed.config.experiment import Experiment
from testbed.core.law import Concern
from testbed.core.vehicle import Gauges

LARGEST_ERROR = 0.3  # a criterion beyond this is met by a vehicle that hardly flies [m]
CAMERAS = (  # key, largest plausible value, unit, what is usual
    ("noise", 0.02, "m", "published cameras have 0.0001 to 0.001 m; mm meant?"),
    ("noise_deg", 5.0, "deg", "published cameras have 0.01 to 0.1 deg"),
    ("jitter_s", 0.1, "s", "published cameras have 0.001 to 0.01 s; ms meant?"),
    ("dropout_s", 5.0, "s", "one loss of a body lasts 0.02 to 0.5 s; ms meant?"),
)
LINKS = (
    ("delay_s", 0.5, "s", "Wi-Fi has 0.002 to 0.05 s; ms meant?"),
    ("jitter_s", 0.5, "s", "Wi-Fi has 0.001 to 0.05 s; ms meant?"),
    ("loss", 0.5, "", "a share, Wi-Fi has 0.001 to 0.05; percent meant?"),
)


def doubtful_surroundings(experiment: Experiment) -> Iterator[Concern]:
    """Warnings about an experiment's cameras, radio and criteria, and its vehicles' batteries."""
    table = experiment.table
    for name, part, limits in (
        ("cameras", "mocap", CAMERAS), ("radio", "link", LINKS),
    ):  # fmt: skip
        yield from _beyond(name, f"table.{part}", getattr(table, part), limits)
    for key in ("final_error_m", "hold_rms_m", "track_rms_m"):
        limit = getattr(experiment.criteria, key)
        if limit is not None and limit > LARGEST_ERROR:
            text = (
                f"criteria.{key} is {limit:g} m: it is met however badly a vehicle flies; mm meant?"
            )
            yield Concern("criterion", text)
    for name, setup in experiment.vehicles.items():
        if setup.model.gauges.battery:
            yield from _battery(experiment, name, setup.model.gauges)


def _beyond(
    name: str, where: str, part: Any, limits: tuple[tuple[str, float, str, str], ...]
) -> Iterator[Concern]:
    for key, most, unit, usual in limits:
        if (value := getattr(part, key)) > most:
            yield Concern(name, f"{where}.{key} is {value:g}{' ' if unit else ''}{unit}: {usual}")


def _battery(experiment: Experiment, name: str, gauges: Gauges) -> Iterator[Concern]:
    """Limits for another battery than the vehicle's."""
    least, most = experiment.arming.volts(gauges.battery_v)
    floors = [
        one.below
        for one in experiment.faults.values()
        if one.detector == "battery" and one.response != "warn" and one.below is not None
    ]
    least = max([least, gauges.undervoltage_v, *floors])
    if not least <= gauges.battery_v <= most:
        supply = f"at least {least:g} V" if least > gauges.battery_v else f"at most {most:g} V"
        yield Concern(
            "battery",
            f"{name}: it flies with {supply} only, and its battery has {gauges.battery_v:g} V:"
            " gauges.battery_v or the limits (arming.battery, gauges.undervoltage_v, the fault"
            " table's row) are wrong",
        )
