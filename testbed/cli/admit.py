"""`testbed admit`: fly an experiment in the twin before it is flown on hardware.

A refused experiment can be forced. The operator types its name, because `y` is typed by habit.
"""

import shlex
import sys
from collections.abc import Callable, Iterable, Sequence
from contextlib import redirect_stdout

from msgspec.structs import replace
from rich.console import Console
from rich.table import Table as Grid

from testbed.cli.exit_code import FAILED, OK
from testbed.cli.refusal import errors, refuse
from testbed.cli.screen import print_json, print_text, show
from testbed.cli.tracked import tracked
from testbed.config import ConfigError, Experiment, find, load
from testbed.core.spelling import counted
from testbed.metrics.admission import (
    Admission,
    AdmissionFlight,
    AdmissionParams,
    judge_flights,
    nearest_edge,
    nearest_rims,
)
from testbed.metrics.run_metrics import obstacle_distances
from testbed.rig.chain import fence_of
from testbed.rig.observers import NullObserver
from testbed.rig.twin import make_twin


def fly_once(experiment: Experiment, seed: int) -> AdmissionFlight:
    """One flight in the twin, without injected faults."""
    rig = make_twin(replace(experiment, seed=seed, inject=[]))
    ending = rig.fly(NullObserver())
    track, models = rig.track(), {n: s.model for n, s in experiment.vehicles.items()}
    radii = [model.radius for model in models.values()]
    solid = {n: obstacle for n, obstacle in experiment.obstacles.items() if obstacle.solid > 0.0}
    rims = [
        distance - radius - solid[name].solid
        for k, radius in enumerate(radii)
        for name, distance in obstacle_distances(track, k, solid).items()
    ]
    spent = {name: rig.spent(name) for name in models}
    return AdmissionFlight(
        seed,
        ending.fault,
        len(rig.twin.plant.touches),
        nearest_edge(track, [fence_of(experiment, name) for name in models]),
        nearest_rims(track, radii),
        min(rims, default=None),
        max(spent[name].gas / model.air.gas for name, model in models.items()),
        max((spent[name].openings or 0) / len(model.jets) for name, model in models.items()),
        ending.found_t,
    )


def admit(
    experiment: Experiment, seeds: Iterable[int], limits: AdmissionParams | None = None
) -> Admission:
    """Fly these seeds and judge the flights."""
    flown = [fly_once(experiment, seed) for seed in seeds]
    return judge_flights(experiment.name, flown, limits or AdmissionParams())


def forced(name: str, asked: Callable[[str], str]) -> bool:
    """Whether the operator overrides the refusal by typing the experiment's name."""
    try:
        return asked(f"To override, type the name of the experiment [{name}]: ") == name
    except EOFError:  # no operator at the terminal
        return False


def run_admission(
    name: str, overrides: Sequence[str], flights: int, *, force: bool, as_json: bool
) -> int:
    """Fly, judge and print; return the exit code."""
    try:
        with redirect_stdout(sys.stderr):  # keeps a law's prints out of the result
            experiment = load(find(name), overrides)
    except ConfigError as error:
        return refuse(error)
    seeds = range(experiment.seed, experiment.seed + flights)
    words = "flying in the twin (the first flight compiles)"
    with redirect_stdout(sys.stderr):
        admission = admit(experiment, tracked(seeds, words, flights))
    if as_json:
        print_json(admission)
    else:
        print_admission(admission, command(name, overrides))
    if admission.admitted:
        return OK
    if force and forced(experiment.name, errors.input):
        errors.print("refusal overridden", style="yellow")
        return OK
    return FAILED


def command(name: str, overrides: Sequence[str]) -> str:
    """What flies one of the flights again, but for its seed."""
    return shlex.join(["testbed", "run", name, *overrides, "--seed"])


def print_admission(admission: Admission, again: str = "testbed run --seed") -> None:
    """Print the worst value of each limit, the flights that broke one, and the verdict."""
    out = Console(highlight=False)
    title = f"{admission.experiment}, {counted(admission.flights, 'flight')} in the twin"
    grid = Grid(title=title, title_justify="left", title_style="bold")
    for heading in ("", "worst", "seed"):
        grid.add_column(heading)
    for one in admission.findings:
        grid.add_row(one.name, one.words, str(one.seed), style=None if one.kept else "red")
    show(out, grid)
    for words in admission.faults:
        print_text(out, f"  {words}", "red")
    failed = [one for one in admission.findings if not one.kept]
    for seed in dict.fromkeys(one.seed for one in failed):
        out.print(f"  see it: {again} {seed}", markup=False, soft_wrap=True)
    broken = ", ".join(one.name for one in failed)
    verdict = "[bold green]admitted[/]" if not broken else f"[bold red]refused[/]: {broken}"
    out.print(verdict)
