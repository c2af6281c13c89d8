"""Tuning: an optimiser chooses gains, and every choice is flown with the same seeds.

    name = "hold_pd"
    experiment = "hold"
    set = ["duration_s=60"]
    trials = 40                           # number of choices
    samples = 3                           # runs per choice, with seeds seed, seed + 1, ...
    sampler = "tpe"                       # or "cmaes"
    cost = { goal_rms_m = 1000.0, gas_g = 0.02 }      # weights; mean over the samples
    most = { max_force_n = 0.8 }          # safety: no run may exceed it
    least = { clearance_m = 0.02 }        # safety: no run may fall below it

    [[gain]]
    key = "controller.bandwidth"
    low = 0.05
    high = 0.6
    log = true

Columns are those of a campaign's results. A choice is unsafe if any of its runs ends by a fault,
misses a criterion of the experiment or breaks a bound; it loses to every safe choice. The first
choice is the original gains of the experiment.

The optimiser proposes `together` choices at a time, independent of the number of workers, and a
journal stores their costs. A restarted tuning gets the same proposals and so resumes.
"""

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal, Protocol

import msgspec
import tomli_w
from msgspec import Meta, Struct

from testbed.campaign.anchor import anchored
from testbed.campaign.row import FlownRun, Task, broken_bound, check_columns, check_vehicles, column
from testbed.campaign.sweep import (
    Count,
    Limit,
    base_experiment,
    check_name,
    experiment_path,
    read_file,
)
from testbed.config import ConfigError, dump, load
from testbed.config.error import show
from testbed.config.experiment import Seed
from testbed.config.key import assignment
from testbed.core.error import MismatchError
from testbed.core.extra import needs_extra
from testbed.core.vehicle import Positive

BROKEN = 1e6  # cost of each run that breaks a safety bound
PROOF_SEEDS = 1_000_000  # offset of the seeds that the tuning does not use

Fly = Callable[[Sequence[Task]], Iterator[FlownRun]]


class Gain(Struct, frozen=True, forbid_unknown_fields=True):
    """A number to choose, and its range."""

    key: str
    low: float
    high: float
    log: bool = False

    def __post_init__(self) -> None:
        found = f"{self.low:g} and {self.high:g} for {self.key}"
        if not self.low < self.high:
            raise MismatchError("low < high", found)
        if self.log and self.low <= 0.0:
            raise MismatchError("low > 0 for log", found)


class TuningFile(Struct, frozen=True, forbid_unknown_fields=True):
    """Content of a tuning file."""

    name: str
    experiment: str
    gain: Annotated[list[Gain], Meta(min_length=1, max_length=50)]
    cost: Annotated[dict[str, Positive], Meta(min_length=1)]
    description: str = ""
    set: list[str] = []
    most: dict[str, float] = {}
    least: dict[str, float] = {}
    trials: Count = 40
    samples: Count = 3
    seed: Seed = 0
    sampler: Literal["tpe", "cmaes"] = "tpe"
    together: Annotated[int, Meta(ge=1, le=1000)] = 4
    proof: Annotated[int, Meta(ge=0, le=10_000)] = 10  # seeds of the comparison at the end
    limit_s: Limit = 3600.0  # computing time after which a run is lost [s]


class Trial(Struct, frozen=True):
    """One choice of gains and its cost."""

    number: int
    gains: list[float]
    cost: float
    broken: int  # number of runs that broke a bound
    reason: str = ""  # why the first of them did
    reasons: list[str] = []  # why each of them did, with its seed


class Tuning:
    """A tuning file with its experiment."""

    def __init__(self, file: TuningFile, base: str, now: list[float]) -> None:
        self.file = file
        self.base = base  # the resolved experiment, as TOML
        self.now = now  # the original gains

    def payload(self) -> bytes:
        """Everything that determines what is flown."""
        return msgspec.json.encode((self.file, self.base))

    def overrides(self, gains: Sequence[float]) -> tuple[str, ...]:
        """The overrides of a choice."""
        pairs = zip(self.file.gain, gains, strict=True)
        return tuple(f"{gain.key}={value!r}" for gain, value in pairs)

    def tasks(self, first: int, gains: Sequence[float], seeds: Sequence[int]) -> list[Task]:
        """The runs of a choice, numbered from `first`."""
        texts = self.overrides(gains)
        return [(first + j, (*texts, f"seed={seed}")) for j, seed in enumerate(seeds)]


def load_tuning(path: Path) -> Tuning:
    """Read and check a tuning file and the experiment it names.

    Raises:
        ConfigError: the file, the experiment, or an end of a gain is invalid.
    """
    file = read_file(path, TuningFile)
    check_name(path, file.name)
    base = base_experiment(path, file.experiment, file.set)
    tree = dump(base)
    for key, columns in (("cost", file.cost), ("most", file.most), ("least", file.least)):
        check_columns(str(path), key, columns)
        check_vehicles(str(path), key, columns, base.vehicles)
    keys = [gain.key for gain in file.gain]
    placed = [anchored(text, path.parent) for text in file.set]
    for gain in file.gain:
        if keys.count(gain.key) > 1:
            raise ConfigError(str(path), "gain", "each key once", show(gain.key))
        for end in (gain.low, gain.high):
            text = f"{gain.key}={float(end)!r}"
            try:
                load(experiment_path(path, file.experiment), [*placed, text])
            except ConfigError as error:
                where = f"{path}, the choice {text}"
                raise ConfigError(
                    where, error.key, error.expected, error.found, error.hint
                ) from None
    now = [_value(path, tree, gain) for gain in file.gain]
    return Tuning(file, tomli_w.dumps(tree), now)


def _value(path: Path, tree: Any, gain: Gain) -> float:
    """The original value of a gain, clipped to its range."""
    value = tree
    for part in assignment(f"{gain.key}=0")[0]:
        if part == "*":
            value = next(iter(value.values() if isinstance(value, dict) else value))
        else:
            value = value.get(part) if isinstance(value, dict) else value[int(part) - 1]
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise ConfigError(str(path), gain.key, "a key that holds a number", str(value))
    return min(gain.high, max(gain.low, float(value)))


def judged(tuning: Tuning, number: int, gains: list[float], runs: Sequence[FlownRun]) -> Trial:
    """The cost of a choice.

    Raises:
        ConfigError: a column of the costs or bounds does not exist.
    """
    file, cost, first = tuning.file, 0.0, ""
    reasons: list[str] = []
    for run in sorted(runs, key=lambda run: run.k):
        if reason := broken(file, run):
            first = first or reason
            reasons.append(run.explained(reason))
        for name, weight in file.cost.items():
            cost += weight * float(run.columns.get(name) or 0.0) / len(runs)
    return Trial(number, gains, cost + BROKEN * len(reasons), len(reasons), first, reasons)


def broken(file: TuningFile, run: FlownRun) -> str:
    """Why a run is unsafe; empty if it is safe."""
    if run.outcome != "passed":
        return f"{run.outcome}: {run.reason}"
    for name in file.cost:
        if column(run.columns, name) is None:
            return f"{name} does not apply, or was not reached"
    return broken_bound(run.columns, file.most, file.least)


class Optimiser(Protocol):
    """Proposes gains, and learns their costs."""

    def ask(self) -> list[float]:
        """Values of the gains to try next."""
        ...

    def tell(self, cost: float) -> None:
        """Report the cost of the oldest choice without one."""
        ...


class OptunaOptimiser:
    """Optuna's TPE or CMA-ES; the same file gives the same choices."""

    def __init__(self, tuning: Tuning) -> None:
        with needs_extra("campaign"):
            import optuna
        optuna.logging.set_verbosity(optuna.logging.ERROR)
        file = tuning.file
        samplers = optuna.samplers
        sampler = (
            samplers.CmaEsSampler(seed=file.seed)
            if file.sampler == "cmaes"
            else samplers.TPESampler(seed=file.seed)
        )
        self._gains = file.gain
        self._study = optuna.create_study(sampler=sampler)
        self._study.enqueue_trial(
            {gain.key: value for gain, value in zip(file.gain, tuning.now, strict=True)}
        )
        self._open: list[Any] = []

    def ask(self) -> list[float]:
        """See `Optimiser`."""
        trial = self._study.ask()
        self._open.append(trial)
        return [trial.suggest_float(g.key, g.low, g.high, log=g.log) for g in self._gains]

    def tell(self, cost: float) -> None:
        """See `Optimiser`."""
        self._study.tell(self._open.pop(0), cost)


def tune(
    tuning: Tuning,
    optimiser: Optimiser,
    known: Sequence[Trial],
    fly: Fly,
    done: Callable[[Trial], None],
) -> list[Trial]:
    """Fly the trials that are not known, and return all.

    Args:
        tuning: gains, costs and bounds.
        optimiser: proposes the choices.
        known: trials of an earlier call, from the first one on.
        fly: maps tasks to their results.
        done: called with each new trial.
    """
    file = tuning.file
    seeds = range(file.seed, file.seed + file.samples)
    trials: list[Trial] = []
    while len(trials) < file.trials:
        first = len(trials)
        numbers = range(first, min(file.trials, first + file.together))
        choices = {number: optimiser.ask() for number in numbers}
        found = {t.number: t for t in known if t.number in choices}
        if any(found[n].gains != choices[n] for n in found):
            words = "other choices: the version of the optimiser has changed"
            raise ConfigError(file.name, "", "the choices of the journal", words)
        tasks = [
            task
            for number, gains in choices.items()
            if number not in found
            for task in tuning.tasks(number * file.samples, gains, seeds)
        ]
        runs: dict[int, list[FlownRun]] = {}
        for run in fly(tasks) if tasks else ():
            number = run.k // file.samples
            runs.setdefault(number, []).append(run)
            if len(runs[number]) == file.samples:
                found[number] = judged(tuning, number, choices[number], runs.pop(number))
                done(found[number])
        for number in numbers:
            optimiser.tell(found[number].cost)
            trials.append(found[number])
    return trials


def best_of(trials: Sequence[Trial]) -> Trial | None:
    """The safe trial with the lowest cost, the earlier of equals; None if no trial is safe."""
    inside = [trial for trial in trials if trial.broken == 0]
    return min(inside, key=lambda trial: (trial.cost, trial.number)) if inside else None
