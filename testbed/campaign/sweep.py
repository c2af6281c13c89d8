"""A campaign file and its list of runs.

    name = "margins"
    experiment = "zhang2023_table"        # shipped, or a path relative to this file
    set = ["duration_s=100"]              # overrides for every run
    samples = 200                         # runs for each combination of the grid
    seed = 0                              # sample j flies with seed + j and has its own draws

    [[grid]]
    key = "table.mocap.latency_s"
    values = [0.02, 0.05, 0.1]

    [[grid]]                              # several keys that change together
    name = "law"
    cases.paper = []
    cases.naive = ["controller={type='pd'}", "guidance.mode=wrench"]

    [[draw]]
    key = "vehicles.*.model.mass"
    low = 11.0
    high = 14.0

The grid has G combinations; run k is sample k // G on combination k % G. So a run depends only on
the file and on k, every combination gets the same seeds and draws, and a stopped campaign has flown
all combinations equally often.
"""

import math
import re
from collections.abc import Iterator
from itertools import product
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec
import numpy as np
import tomli_w
from msgspec import Meta, Struct
from msgspec.structs import replace
from numpy.typing import NDArray
from scipy.stats import norm, qmc

from testbed.campaign.anchor import anchored, files_of
from testbed.campaign.inline_toml import inline
from testbed.campaign.row import COLUMNS, check_columns, check_vehicles
from testbed.config import ConfigError, Experiment, dump, find, load, loads, read_toml
from testbed.config.error import show
from testbed.config.experiment import Seed
from testbed.config.key import ANY, Key, assignment, spell
from testbed.config.tree import leaves
from testbed.config.validation import first_violation
from testbed.core.error import MismatchError
from testbed.core.table import Probability
from testbed.core.vehicle import Positive
from testbed.run.code_digest import digest_of

MOST_RUNS = 1_000_000
MOST_CHECKED = 200  # combinations that are checked before the first run
SEED: Key = ("seed",)
MAY_CHANGE = ("description", "keep", "confidence", "success", "limit_s")  # during a campaign

Count = Annotated[int, Meta(ge=1, le=MOST_RUNS)]
Limit = Annotated[float, Meta(gt=0.0, le=604_800.0)]
Overrides = tuple[str, ...]
Parameters = dict[str, float | int | bool | str]


class GridAxis(Struct, frozen=True, forbid_unknown_fields=True):
    """One axis of the grid: the values of a key, or named cases of several keys."""

    key: str = ""
    name: str = ""  # column name; default: the key
    values: list[Any] = []
    cases: dict[str, list[str]] = {}

    def __post_init__(self) -> None:
        given = bool(self.key) and bool(self.values), bool(self.name) and bool(self.cases)
        if given == (True, False) and not self.cases:
            return
        if given == (False, True) and not self.values and not self.key:
            return
        if (self.key or self.name) and not self.values and not self.cases:
            raise MismatchError("one value or more, or cases", f"none for {self.label}")
        raise MismatchError("either key and values, or name and cases", "neither or both")

    @property
    def label(self) -> str:
        """What the column is called."""
        return self.name or self.key

    def points(self) -> list[tuple[float | int | bool | str, Overrides]]:
        """Each value as displayed, with its overrides."""
        if self.cases:
            return [(name, tuple(texts)) for name, texts in self.cases.items()]
        return [(_shown(value), (f"{self.key}={inline(value)}",)) for value in self.values]


class Draw(Struct, frozen=True, forbid_unknown_fields=True):
    """A random number for each sample: uniform between two ends, or normal."""

    key: str
    name: str = ""
    low: float | None = None
    high: float | None = None
    mean: float | None = None
    sd: Positive | None = None
    log: bool = False  # uniform in the logarithm
    whole: bool = False  # whole numbers, all equally likely if uniform

    def __post_init__(self) -> None:
        ends, bell = (self.low, self.high), (self.mean, self.sd)
        if {ends.count(None), bell.count(None)} != {0, 2}:
            raise MismatchError("low and high, or mean and sd", "neither or both")
        if self.low is not None and self.high is not None:
            found = f"{self.low:g} and {self.high:g} for {self.key}"
            if not self.low < self.high:
                raise MismatchError("low < high", found)
            if self.log and self.low <= 0.0:
                raise MismatchError("low > 0 for log", found)
            if self.whole and not (self.low.is_integer() and self.high.is_integer()):
                raise MismatchError("whole ends for whole", found)
        elif self.log:
            raise MismatchError("low and high for log", f"mean and sd for {self.key}")

    @property
    def label(self) -> str:
        """What the column is called."""
        return self.name or self.key

    def at(self, share: float) -> float | int:
        """The quantile: the value below which this `share` of all draws lies."""
        if self.mean is not None and self.sd is not None:
            value = float(norm.ppf(share, self.mean, self.sd))
            return round(value) if self.whole else value
        assert self.low is not None
        assert self.high is not None
        room = 0.5 if self.whole else 0.0  # else rounding would make the ends half as likely
        low, high = self.low - room, self.high + room
        if self.log:
            value = low * math.exp(share * math.log(high / low))
        else:
            value = low + share * (high - low)
        return int(min(self.high, max(self.low, round(value)))) if self.whole else value


class CampaignFile(Struct, frozen=True, forbid_unknown_fields=True):
    """Content of a campaign file."""

    name: str  # also the name of the folder
    experiment: str
    description: str = ""
    set: list[str] = []
    samples: Count = 1
    seed: Seed = 0
    design: Literal["random", "latin_hypercube"] = "random"
    grid: list[GridAxis] = []
    draw: list[Draw] = []
    most: dict[str, float] = {}  # upper bounds of columns; a run above one has failed
    least: dict[str, float] = {}  # lower bounds
    keep: Annotated[int, Meta(ge=0, le=1000)] = 20  # failures whose log is kept
    confidence: Annotated[float, Meta(gt=0.5, lt=1.0)] = 0.95  # of the interval
    success: Probability | None = None  # required lower end of the interval
    limit_s: Limit = 3600.0  # computing time after which a run is lost [s]


class Campaign:
    """A campaign file with its base experiment."""

    def __init__(self, file: CampaignFile, base: str, folder: Path) -> None:
        self.file = file
        self.base = base  # the resolved experiment, as TOML
        axes = [  # paths are relative to the file, which is in `folder`
            [(shown, tuple(anchored(text, folder) for text in texts)) for shown, texts in points]
            for points in (axis.points() for axis in file.grid)
        ]
        self._grid = list(product(*axes))
        used = [text for points in axes for _, texts in points for text in texts]
        self.files = [one for text in used for one in files_of(text)]  # that the grid names
        self._shares = shares(file)

    @property
    def count(self) -> int:
        """Number of runs: combinations times runs of each."""
        return len(self._grid) * self.file.samples

    @property
    def combinations(self) -> int:
        """Number of combinations of the grid."""
        return len(self._grid)

    def parameters(self, k: int) -> Parameters:
        """The parameters of run k, by column."""
        sample, point = divmod(k, len(self._grid))
        named = {
            axis.label: shown
            for axis, (shown, _) in zip(self.file.grid, self._grid[point], strict=True)
        }
        drawn = {draw.label: value for draw, value in self._drawn(sample)}
        return {**named, **drawn, "seed": self.file.seed + sample}

    def overrides(self, k: int) -> Overrides:
        """The overrides of run k."""
        sample, point = divmod(k, len(self._grid))
        texts = [text for _, texts in self._grid[point] for text in texts]
        texts += [f"{draw.key}={value!r}" for draw, value in self._drawn(sample)]
        return (*texts, f"seed={self.file.seed + sample}")

    def _drawn(self, sample: int) -> list[tuple[Draw, float | int]]:
        row = self._shares[sample]
        return [(draw, draw.at(float(u))) for draw, u in zip(self.file.draw, row, strict=True)]

    def payload(self) -> bytes:
        """Everything that determines what a run flies, and whether it passes."""
        content = {str(file): digest_of(file.read_bytes()) for file in self.files}
        return msgspec.json.encode((deciding(self.file), self.base, content))


def deciding(file: CampaignFile) -> CampaignFile:
    """The file without the keys that may change during a campaign, as they affect no run.

    More samples append runs and change none, except with a Latin hypercube.
    """
    plain = CampaignFile(name=file.name, experiment=file.experiment)
    whole = file.design == "latin_hypercube" and bool(file.draw)
    free = MAY_CHANGE if whole else (*MAY_CHANGE, "samples")
    return replace(file, **{key: getattr(plain, key) for key in free})


def difference(old: Any, new: Any) -> str:
    """The first difference between two trees, as text; empty if there is none."""
    before, now = ({spell(k): v for k, v in leaves(tree)} for tree in (old, new))
    for key in (*before, *now):
        if (a := before.get(key)) != (b := now.get(key)):
            words = [show(value) if value is not None else "nothing" for value in (a, b)]
            return f"`{key}` was {words[0]} and is {words[1]}"
    return ""


def shares(file: CampaignFile) -> NDArray[np.float64]:
    """Uniform numbers from 0 to 1 for each sample's draws, shape (samples, draws).

    In a random design each key has its own stream, so more samples or another key change no
    existing draw. A Latin hypercube changes as a whole.
    """
    if not file.draw:
        return np.zeros((file.samples, 0))
    if file.design == "latin_hypercube":
        rng = np.random.default_rng(_stream(file.seed, "latin hypercube"))
        return qmc.LatinHypercube(len(file.draw), rng=rng).random(file.samples)
    columns = [
        np.random.default_rng(_stream(file.seed, f"draw {draw.key}")).random(file.samples)
        for draw in file.draw
    ]
    return np.array(columns).T


def _stream(seed: int, name: str) -> np.random.SeedSequence:
    return np.random.SeedSequence(seed, spawn_key=tuple(f"campaign/{name}".encode()))


def _shown(value: Any) -> float | int | bool | str:
    return value if isinstance(value, bool | int | float | str) else inline(value)


def load_campaign(path: Path) -> Campaign:
    """Read and check a campaign file and the experiment it names.

    Raises:
        ConfigError: the file, the experiment, or a corner of the sweep is invalid.
    """
    file = read_file(path, CampaignFile)
    check_name(path, file.name)
    check_replaced(path, file)
    names = [axis.label for axis in file.grid] + [draw.label for draw in file.draw]
    for name in names:
        if names.count(name) > 1 or name == "seed":
            raise ConfigError(str(path), "", "each column once, and none called seed", show(name))
        if name in COLUMNS or name.startswith("met."):
            expected = "another `name`"
            raise ConfigError(str(path), "", expected, f"{show(name)}, a column of the results")
    for axis in file.grid:
        shown = [show(value) for value in axis.values]
        if twice := [value for value in shown if shown.count(value) > 1]:
            raise ConfigError(
                str(path), axis.key, "each value once: repeated runs add no evidence", twice[0]
            )
    for key, bounds in (("most", file.most), ("least", file.least)):
        check_columns(str(path), key, bounds)
    size = math.prod(len(axis.points()) for axis in file.grid) * file.samples
    if size > MOST_RUNS:
        raise ConfigError(str(path), "", f"at most {MOST_RUNS} runs", str(size))
    base = base_experiment(path, file.experiment, file.set)
    if any(assignment(text)[0] == SEED for text in file.set):
        raise seed_error(path, "set")
    campaign = Campaign(file, tomli_w.dumps(dump(base)), path.parent)
    check_corners(path, campaign)
    return campaign


def seed_error(path: Path, where: str) -> ConfigError:
    """The error for a file that sets the seed of every run."""
    expected = "`seed` and `samples` of the campaign: sample j flies with seed + j"
    return ConfigError(str(path), where, expected, "the key `seed`")


def check_replaced(path: Path, file: CampaignFile) -> None:
    """Refuse a key that another one overwrites, because its column would be wrong."""
    settings = [
        (axis.label, text) for axis in file.grid for _, texts in axis.points() for text in texts
    ] + [(draw.label, f"{draw.key}=0") for draw in file.draw]
    keys = dict.fromkeys((label, key_of(path, label, text)) for label, text in settings)
    for place, (label, key) in enumerate(keys):
        if key == SEED:
            raise seed_error(path, label)
        for other, later in list(keys)[place + 1 :]:
            if other != label and covers(later, key):
                expected = f"a `{spell(key)}` that no other setting replaces"
                cure = "keep one" if later == key else "put it into cases, after its replacement"
                found = f"`{spell(later)}` of {other}, which replaces it; {cure}"
                raise ConfigError(str(path), label, expected, found)


def key_of(path: Path, label: str, text: str) -> Key:
    """The key that an axis or a draw sets."""
    try:
        return assignment(text)[0]
    except ValueError:
        raise ConfigError(str(path), label, "key=value", show(text)) from None


def covers(key: Key, other: Key) -> bool:
    """Whether setting `key` overwrites all of `other`."""
    pairs = zip(key, other, strict=False)
    return len(key) <= len(other) and all(a in (b, ANY) for a, b in pairs)


def check_corners(path: Path, campaign: Campaign) -> None:
    """Refuse a campaign with an invalid combination, end of a draw, or bound."""
    names: dict[str, None] = {}  # of vehicles
    for texts in corners(campaign):
        try:
            names |= dict.fromkeys(loads(campaign.base, texts).vehicles)
        except ConfigError as error:
            where = f"{path}, the run with {' '.join(texts)}"
            raise ConfigError(where, error.key, error.expected, error.found, error.hint) from None
    for key, bounds in (("most", campaign.file.most), ("least", campaign.file.least)):
        check_vehicles(str(path), key, bounds, names)


def read_file(path: Path, kind: type[Any]) -> Any:
    """Read a TOML file as a struct.

    Raises:
        ConfigError: the file is invalid.
    """
    tree = read_toml(path)
    try:
        return msgspec.convert(tree, kind)
    except msgspec.ValidationError as error:
        violation = first_violation(tree, kind)
        expected = violation.expected if violation.key else str(error)
        raise ConfigError(str(path), spell(violation.key), expected, violation.found) from None


def check_name(path: Path, name: str) -> None:
    """Refuse a name that cannot be part of a folder name."""
    if not re.fullmatch(r"[A-Za-z0-9][\w.-]{0,63}", name, re.ASCII):
        expected = "at most 64 letters, digits, `_`, `-`, `.`, the first a letter or digit"
        raise ConfigError(str(path), "name", expected, show(name))


def experiment_path(path: Path, name: str) -> Path:
    """Path of the experiment that the file at `path` names."""
    beside = path.parent / name
    return beside if beside.is_file() else find(name)


def base_experiment(path: Path, name: str, overrides: list[str]) -> Experiment:
    """The experiment that the file at `path` names, with the overrides for all runs."""
    try:
        placed = [anchored(text, path.parent) for text in overrides]
        return load(experiment_path(path, name), placed)
    except ConfigError as error:
        if error.where == name:  # the experiment does not exist
            raise ConfigError(str(path), "experiment", error.expected, error.found) from None
        if error.where.startswith("command line"):
            where = f"{path}, set{error.where.removeprefix('command line')}"
            raise ConfigError(where, error.key, error.expected, error.found, error.hint) from None
        raise


def corners(campaign: Campaign) -> Iterator[Overrides]:
    """Both ends of each draw, and each combination of the grid with the first draws."""
    first = campaign.overrides(0)
    for draw in campaign.file.draw:
        ends = (0.0, 1.0) if draw.mean is None else (0.001, 0.999)
        others = [text for text in first if not text.startswith(f"{draw.key}=")]
        yield from ((*others, f"{draw.key}={draw.at(share)!r}") for share in ends)
    combinations = min(campaign.combinations, MOST_CHECKED)
    yield from (campaign.overrides(k) for k in range(combinations))
