"""The benchmark of record: standard scenarios under all laws, all scored the same way.

A benchmark file lists the laws, their gains, the scenarios and the limits. Every scenario is a
campaign over its laws, once with the vehicles as their file describes them and once with
`trouble`, which the laws do not know.
"""

import math
import statistics
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import tomli_w
from msgspec import Meta, Struct, field

from testbed.campaign.row import FLOWN, FlownRun, Number, check_columns
from testbed.campaign.summary import short_reason
from testbed.campaign.sweep import (
    Campaign,
    CampaignFile,
    GridAxis,
    base_experiment,
    check_corners,
    check_name,
    read_file,
)
from testbed.config import ConfigError, dump
from testbed.config.error import did_you_mean
from testbed.config.experiment import Seed

SHIPPED, OFF = "as its file", "off"


class BenchmarkScenario(Struct, frozen=True, forbid_unknown_fields=True):
    """An experiment and the laws that fly it."""

    experiment: str
    laws: Annotated[list[str], Meta(min_length=1)]
    set: list[str] = []
    description: str = ""  # default: the experiment's
    hardware: str = ""  # how a lab reproduces what `set` does on the twin
    most: dict[str, float] = {}
    least: dict[str, float] = {}


class BenchmarkFile(Struct, frozen=True, forbid_unknown_fields=True):
    """Content of a benchmark file."""

    name: str
    laws: dict[str, list[str]]  # "key=value" overrides that select a law and its gains
    scenarios: Annotated[dict[str, BenchmarkScenario], Meta(min_length=1)]
    samples: Annotated[int, Meta(ge=1, le=10_000)] = 4
    seed: Seed = 0
    trouble: list[str] = field(default_factory=list)
    trouble_hardware: str = ""  # how a lab reproduces it, or that it cannot
    notes: list[str] = []  # notes for readers of the scores


class Score(Struct, frozen=True):
    """One law in one scenario; null where a number does not apply."""

    scenario: str
    law: str
    runs: int
    passed: int
    error_m: float | None  # median over the runs
    worst_error_m: float | None
    settle_s: float | None  # median; null if a run never settled
    clearance_m: float | None  # smallest, to an obstacle's danger radius
    vehicle_distance_m: float | None  # smallest, centre to centre
    contacts: int
    gas_g: float | None  # median, all vehicles together
    valve_pulses: float | None
    robust_runs: int
    robust_passed: int
    rig: str = "twin"
    reasons: dict[str, int] = {}  # why runs did not pass, and how many; most frequent first
    robust_reasons: dict[str, int] = {}


class PassedOver(Struct, frozen=True):
    """A folder that was not scored."""

    folder: str
    reason: str


class Record(Struct, frozen=True):
    """The scores of a benchmark, and what `--json` prints."""

    benchmark: str
    version: str  # of the program that flew
    scores: list[Score]
    code: str | None = None  # digest of the code; unknown for run folders
    passed_over: list[PassedOver] = []
    not_flown: list[str] = []  # "scenario: laws", or "scenario: law, seeds"
    own: list[str] = []  # settings of the runs that are a lab's own


def load_benchmark(path: Path) -> BenchmarkFile:
    """Read and check a benchmark file.

    Raises:
        ConfigError: something is wrong.
    """
    file: BenchmarkFile = read_file(path, BenchmarkFile)
    check_name(path, file.name)
    for name, scenario in file.scenarios.items():
        check_name(path, name)
        for key, bounds in (("most", scenario.most), ("least", scenario.least)):
            check_columns(str(path), f"scenarios.{name}.{key}", bounds)
        for law in scenario.laws:
            if law not in file.laws:
                expected = f"one of [laws]: {', '.join(file.laws)}"
                found = f"{law}{did_you_mean(law, file.laws)}"
                raise ConfigError(str(path), f"scenarios.{name}.laws", expected, found)
    return file


def scenario_campaign(path: Path, file: BenchmarkFile, name: str) -> Campaign:
    """One scenario as a campaign over its laws.

    Raises:
        ConfigError: the experiment does not exist, or a law does not fit it.
    """
    scenario = file.scenarios[name]
    states = {SHIPPED: [], OFF: file.trouble} if file.trouble else {SHIPPED: []}
    campaign_file = CampaignFile(
        name=f"{file.name}_{name}",
        experiment=scenario.experiment,
        set=scenario.set,
        samples=file.samples,
        seed=file.seed,
        grid=[
            GridAxis(name="law", cases={law: file.laws[law] for law in scenario.laws}),
            GridAxis(name="vehicle", cases=states),
        ],
        most=scenario.most,
        least=scenario.least,
        keep=3,
    )
    base = base_experiment(path, scenario.experiment, scenario.set)
    campaign = Campaign(campaign_file, tomli_w.dumps(dump(base)), path.parent)
    check_corners(path, campaign)
    return campaign


def scores(campaign: Campaign, scenario: str, runs: Sequence[FlownRun]) -> list[Score]:
    """Score every law of a scenario."""
    by_law: dict[str, tuple[list[FlownRun], list[FlownRun]]] = {}
    for run in runs:
        parameters = campaign.parameters(run.k)
        pair = by_law.setdefault(str(parameters["law"]), ([], []))
        pair[parameters["vehicle"] == OFF].append(run)
    return [score(scenario, law, nominal, off) for law, (nominal, off) in by_law.items()]


def score(scenario: str, law: str, runs: Sequence[FlownRun], off: Sequence[FlownRun] = ()) -> Score:
    """Score one law in one scenario.

    A run that ended early counts as infinitely bad, not with the small error or gas of its first
    seconds.
    """

    def numbers(name: str) -> list[float]:
        values: list[Number] = [run.columns.get(name) for run in runs]
        return [float(value) for value in values if value is not None]

    def to_the_end(name: str) -> list[float]:
        values = [run.columns.get(name) if run.outcome in FLOWN else None for run in runs]
        return [math.inf if value is None else float(value) for value in values]

    def middle(name: str) -> float | None:
        return known(statistics.median(to_the_end(name) or [math.inf]))

    error = "shape_rms_m" if numbers("shape_rms_m") else "goal_rms_m"
    settles = bool(numbers("goal_rms_m")) and max(to_the_end("settle_s")) < math.inf
    return Score(
        scenario=scenario,
        law=law,
        runs=len(runs),
        passed=sum(run.outcome == "passed" for run in runs),
        error_m=middle(error),
        worst_error_m=known(max(to_the_end(error), default=math.inf)),
        settle_s=middle("settle_s") if settles else None,
        clearance_m=min(numbers("clearance_m"), default=None),
        vehicle_distance_m=min(numbers("min_vehicle_distance_m"), default=None),
        contacts=int(sum(numbers("contacts"))),
        gas_g=middle("gas_g"),
        valve_pulses=middle("valve_pulses"),
        robust_runs=len(off),
        robust_passed=sum(run.outcome == "passed" for run in off),
        reasons=reasons(runs),
        robust_reasons=reasons(off),
    )


def reasons(runs: Sequence[FlownRun]) -> dict[str, int]:
    """Why runs did not pass, and how many; most frequent first."""
    counts = Counter(short_reason(run) for run in runs if run.outcome != "passed")
    return dict(counts.most_common())


def known(value: float) -> float | None:
    """The number, or None if it is not finite."""
    return value if math.isfinite(value) else None
