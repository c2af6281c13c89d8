"""Warns about implausible numbers around a vehicle: cameras, radio, period, criteria, battery.

Only `testbed check` prints these, like those of `plausibility`.
"""

from collections.abc import Iterator
from typing import Any

from testbed.config.experiment import Experiment
from testbed.core.law import Concern
from testbed.core.vehicle import Gauges

LARGEST_ERROR = 0.3  # a criterion beyond this is met by a vehicle that hardly flies [m]
Limit = tuple[str, float, float, str, str]
CAMERAS: tuple[Limit, ...] = (  # key, smallest and largest plausible value, unit, what is usual
    ("rate_hz", 20.0, 2000.0, "Hz", "published cameras have 60 to 240 Hz"),
    ("noise", 1e-6, 0.02, "m", "published cameras have 0.0001 to 0.001 m; mm meant?"),
    ("noise_deg", 3e-3, 5.0, "deg", "published cameras have 0.01 to 0.1 deg; rad meant?"),
    ("jitter_s", 0.0, 0.1, "s", "published cameras have 0.001 to 0.01 s; ms meant?"),
    ("dropout_s", 0.0, 5.0, "s", "one loss of a body lasts 0.02 to 0.5 s; ms meant?"),
)
LINKS: tuple[Limit, ...] = (
    ("delay_s", 0.0, 0.5, "s", "Wi-Fi has 0.002 to 0.05 s; ms meant?"),
    ("jitter_s", 0.0, 0.5, "s", "Wi-Fi has 0.001 to 0.05 s; ms meant?"),
    ("loss", 0.0, 0.5, "", "a share, Wi-Fi has 0.001 to 0.05; percent meant?"),
)
PERIODS: tuple[Limit, ...] = (
    ("jet_period_s", 0.0, 0.5, "s", "published vehicles have 0.02 to 0.2 s; Hz meant?"),
)
TOLERANCES: tuple[Limit, ...] = (
    ("direction_deg", 0.05, 20.0, "deg", "nozzles are 0.3 to 3 deg off; rad meant?"),
    ("mass", 0.0, 0.1, "", "a share, a scale has 0.001 to 0.01; kg meant?"),
    ("com", 1e-5, 0.05, "m", "vehicles are balanced to 0.001 to 0.005 m; mm meant?"),
)


def doubtful_surroundings(experiment: Experiment) -> Iterator[Concern]:
    """Warnings about all but the vehicles' bodies, jets and air."""
    table = experiment.table
    for name, where, part, limits in (
        ("cameras", "table.mocap", table.mocap, CAMERAS),
        ("radio", "table.link", table.link, LINKS),
        ("period", "flight", experiment.flight, PERIODS),
    ):
        yield from _beyond(name, where, part, limits)
    for key in ("final_error_m", "hold_rms_m", "track_rms_m"):
        limit = getattr(experiment.criteria, key)
        if limit is not None and limit > LARGEST_ERROR:
            text = (
                f"criteria.{key} is {limit:g} m: it is met however badly a vehicle flies; mm meant?"
            )
            yield Concern("criterion", text)
    for name, setup in experiment.vehicles.items():
        yield from _beyond("tolerance", f"{name}: tolerance", setup.model.tolerance, TOLERANCES)
        if setup.model.gauges.battery:
            yield from _battery(experiment, name, setup.model.gauges)


def _beyond(name: str, where: str, part: Any, limits: tuple[Limit, ...]) -> Iterator[Concern]:
    for key, least, most, unit, usual in limits:
        value = getattr(part, key)
        if value != 0.0 and not least <= value <= most:  # 0: without it
            yield Concern(name, f"{where}.{key} is {value:g}{' ' if unit else ''}{unit}: {usual}")


def _battery(experiment: Experiment, name: str, gauges: Gauges) -> Iterator[Concern]:
    """Warn of limits that the vehicle's battery does not meet."""
    least, most = experiment.arming.battery_limits(gauges.battery_v)
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
