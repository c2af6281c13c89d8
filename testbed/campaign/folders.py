"""Scores the run folders in FOLDER/scenario/law/ for the benchmark, e.g. those of a lab's table.

The folder's path says which run was intended, its config.toml what was flown. A run is scored if
the two agree, except for settings that a lab may have of its own:

    table, vehicles.*.model, board, names    not compared; but on twin and bench, which simulate the
                                             scenario, the values that a scenario sets must match
    faults, arming, flight.estimator         may differ; differences are listed
    defaults that follow from the above      may differ: gains, limits and bounds of faults
    the rig                                  may differ; it is listed

Everything else must match, and each seed is scored once. Skipped folders are listed with reasons.
"""

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec

from testbed.campaign.anchor import anchored
from testbed.campaign.benchmark import BenchmarkFile, PassedOver, Record, score
from testbed.campaign.evidence import read_run
from testbed.campaign.row import FlownRun
from testbed.campaign.sweep import covers, experiment_path
from testbed.config import ConfigError, Experiment, dump, load
from testbed.config.error import did_you_mean, show
from testbed.config.file import derived_of
from testbed.config.key import ANY, Key, assignment, printable, spell
from testbed.metrics.run_metrics import Metrics

NOT_COMPARED: tuple[Key, ...] = (("name",), ("description",), ("seed",))
OF_A_LAB: tuple[Key, ...] = (("table",), ("vehicles", ANY, "model"), ("board",))
NAMED: tuple[Key, ...] = (("faults",), ("arming",), ("flight", "estimator"))
LINK: Key = ("table", "link")  # on the bench messages go over a real network
HEAD = re.compile(r"# Resolved by airbearing-testbed ([^\s;]+);")
ABSENT = object()


def score_folders(path: Path, whole: BenchmarkFile, file: BenchmarkFile, runs: Path) -> Record:
    """Score the run folders in `runs`.

    Args:
        path: path of the benchmark file.
        whole: the complete benchmark; folders that are not in it are listed as skipped.
        file: the part that is scored.
        runs: the folder with the runs.

    Raises:
        ConfigError: no run can be scored.
    """
    pile = Pile(path, file, runs)
    for folder in below(runs):
        if folder.name not in whole.scenarios:
            found = f"not a scenario of the benchmark{did_you_mean(folder.name, whole.scenarios)}"
            pile.pass_over(folder, found)
    table = []
    not_flown: list[str] = []
    for name, scenario in file.scenarios.items():
        for folder in below(runs / name):
            if folder.name not in scenario.laws:
                hint = did_you_mean(folder.name, scenario.laws)
                pile.pass_over(folder, f"not a law of this scenario{hint}")
        missing: list[str] = []
        for law in scenario.laws:
            flown, rigs, left = pile.cell(name, law)
            if not flown:
                missing.append(law)
                continue
            if left:
                seeds = f"seed{'s' * (len(left) > 1)} {', '.join(map(str, left))}"
                not_flown.append(f"{name}: {law}, {seeds}")
            one = score(name, law, flown)
            table.append(msgspec.structs.replace(one, rig=" + ".join(sorted(rigs))))
        if missing == scenario.laws:
            not_flown.append(f"{name}: all")
        elif missing:
            not_flown.append(f"{name}: {', '.join(missing)}")
    if not table:
        expected = (
            "run folders in SCENARIO/LAW/: `testbed benchmark --commands` prints the commands"
        )
        first = [f"{one.folder}: {one.reason}" for one in pile.passed_over[:5]]
        raise ConfigError(str(runs), "", expected, "; ".join(first) or "none")
    return Record(
        benchmark=file.name,
        version=", ".join(sorted(pile.versions)) or "unknown",
        scores=table,
        passed_over=pile.passed_over,
        not_flown=not_flown,
        own=sorted(pile.own),
    )


class Pile:
    """Collects runs from folders, and the findings about them."""

    def __init__(self, path: Path, file: BenchmarkFile, runs: Path) -> None:
        self._path, self._file, self._runs = path, file, runs
        self.passed_over: list[PassedOver] = []
        self.own: set[str] = set()
        self.versions: set[str] = set()

    def pass_over(self, folder: Path, reason: str) -> None:
        """Record a folder as skipped."""
        place = folder.relative_to(self._runs).as_posix()
        self.passed_over.append(PassedOver(printable(place), printable(reason)))

    def cell(self, name: str, law: str) -> tuple[list[FlownRun], set[str], list[int]]:
        """The runs of a law in a scenario, their rigs, and the missing seeds."""
        scenario, place = self._file.scenarios[name], self._runs / name / law
        texts = [*scenario.set, *self._file.laws[law]]
        texts = [anchored(text, self._path.parent) for text in texts]
        wanted = load(experiment_path(self._path, scenario.experiment), texts)
        played = [assignment(text)[0] for text in scenario.set]
        first, flown = self._file.seed, list[FlownRun]()
        rigs: set[str] = set()
        left = list(range(first, first + self._file.samples))
        for folder in below(place):
            try:
                run = read_run(folder, len(flown), scenario.most, scenario.least)
                found = load(folder / "config.toml")
            except ConfigError as error:
                reason = f"{Path(error.where).name}: expected {error.expected}, found {error.found}"
                self.pass_over(folder, reason)
                continue
            metrics = msgspec.json.decode((folder / "metrics.json").read_bytes(), type=Metrics)
            reason, own = compare(wanted, found, metrics.rig, played)
            if not reason and metrics.red:
                reason = f"never armed: {metrics.red[0].words}"
            if not reason and found.seed not in left:
                scored = first <= found.seed < first + self._file.samples
                reason = f"seed {found.seed} is " + (
                    "scored from another folder" if scored else "not in the benchmark"
                )
            if reason:
                self.pass_over(folder, reason)
                continue
            left.remove(found.seed)
            flown.append(run)
            rigs.add(metrics.rig)
            self.own |= own
            with (folder / "config.toml").open(encoding="utf-8") as text:
                head = HEAD.match(text.readline())
            self.versions |= {head[1]} if head else set()
        return flown, rigs, left


def compare(
    wanted: Experiment, found: Experiment, rig: str, played: list[Key]
) -> tuple[str, set[str]]:
    """The reason why a run does not match, or an empty string; and its own settings."""
    own: set[str] = set()
    derived = derived_of(found)
    for key, here, there in differences(dump(wanted), dump(found)):
        if derived.get(key, ABSENT) == there:  # it follows from the lab's vehicles and table
            continue
        by_twin = plays(rig, key) and any(covers(one, key) or covers(key, one) for one in played)
        lab = next((one for one in OF_A_LAB if covers(one, key)), None)
        if any(covers(one, key) for one in NOT_COMPARED) or same_law(key, here, there):
            continue
        if lab is not None and not by_twin:
            own.add(".".join(map(str, lab)))
        elif any(covers(one, key) for one in NAMED):
            own.add(f"{spell(key)} = {shown(there)} (benchmark: {shown(here)})")
        else:
            return f"{spell(key)} is {shown(there)}, the benchmark has {shown(here)}", own
    return "", own


def plays(rig: str, key: Key) -> bool:
    """Whether a rig simulates what the experiment says about the table and the vehicles."""
    return rig == "twin" or (rig == "bench" and not covers(LINK, key))


def same_law(key: Key, here: Any, there: Any) -> bool:
    """Whether only the path of a user's law file differs; its digest is compared separately."""
    laws = [str(text).rpartition(":")[2] for text in (here, there)]
    return key == ("controller", "law") and laws[0] == laws[1]


def differences(here: Any, there: Any, key: Key = ()) -> Iterator[tuple[Key, Any, Any]]:
    """Keys at which two trees differ, with both values."""
    if isinstance(here, dict) and isinstance(there, dict):
        for name in dict.fromkeys([*here, *there]):
            pair = here.get(name, ABSENT), there.get(name, ABSENT)
            yield from differences(*pair, (*key, name))
    elif here is ABSENT or there is ABSENT or here != there:
        yield key, here, there


def shown(value: Any) -> str:
    """A value as text; "not there" if the key is missing."""
    return "not there" if value is ABSENT else show(value)


def below(folder: Path) -> list[Path]:
    """Subfolders, sorted; empty if the folder does not exist."""
    return sorted(one for one in folder.iterdir() if one.is_dir()) if folder.is_dir() else []
