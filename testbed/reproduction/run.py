"""All kinds of runs in a paper's file, and the functions that execute them."""

from testbed.reproduction.centre import Centre, run_centre
from testbed.reproduction.cluster import Swarming, run_swarming
from testbed.reproduction.figure import Figure
from testbed.reproduction.fleet_simulation import Together, run_together
from testbed.reproduction.layout import Layouts, run_layouts
from testbed.reproduction.refusal import RefusedLaw, run_refusal
from testbed.reproduction.table import TableRun, run_table
from testbed.reproduction.targets import Measures, Targets, run_targets

Run = Targets | Together | Swarming | Layouts | Centre | TableRun | RefusedLaw


def execute(run: Run, *, quick: bool) -> tuple[Measures, list[Figure]]:
    """Execute a run: its measures, one value per seed, and its figures."""
    match run:
        case Targets():
            return run_targets(run, quick=quick)
        case Together():
            return run_together(run, quick=quick)
        case Swarming():
            return run_swarming(run, quick=quick)
        case Layouts():
            return run_layouts(run, quick=quick)
        case Centre():
            return run_centre(run, quick=quick)
        case TableRun():
            return run_table(run, quick=quick)
        case RefusedLaw():
            return run_refusal(run, quick=quick)
