"""Jets whose lever is not the file's: the vehicle was rebuilt, or the file is another one's.

On a real table free levers always explain a log a little better. So a lever counts only if it
predicts parts of the log that were left out, see selection.py, clearly better, and by a clear
length.
"""

from collections.abc import Iterator, Sequence

import numpy as np

from testbed.identification.estimate import Estimate, fit
from testbed.identification.jets import JetFinding
from testbed.identification.model import VehicleModel
from testbed.identification.selection import folds, unseen
from testbed.identification.suspicion import Suspicion
from testbed.identification.windows import Windows

ENOUGH = 8  # windows
GAIN = 0.6  # of the square error of unseen parts; healthy logs of three labs reach 0.57
SURE = 1.5  # standard deviations of the gain
INTERVAL = 1.96  # standard deviations of the lever in half of its 95 % interval
LEAST = 0.01  # [m] of a lever


def by_moved_jets(
    model: VehicleModel, jets: Sequence[JetFinding], wide: Estimate, windows: Sequence[Windows]
) -> Iterator[Suspicion]:
    """The jet whose lever, set free, explains most; `wide` is the fit of all groups."""
    names = [f"lever_{one.jet + 1}" for one in jets if one.state == "ok"]
    if not names or sum(len(w.rows) for w in windows) < ENOUGH:
        return
    free = VehicleModel(model.vehicle, valves=True, levers=True)
    free.prior[: len(model.prior)] = model.prior  # dead and weak jets are in it
    start = np.concatenate([wide.p, np.zeros(len(jets))])
    found = fit(free, windows, [*model.groups, *names], start)
    parts = folds(found, windows)
    without = unseen(free, found, parts, model.groups)
    best = max(
        ((without - unseen(free, found, parts, [*model.groups, name]), name) for name in names),
        key=lambda one: float(one[0].mean()),
    )
    gain, k = best[0], free.index(best[1])
    lever, sigma = float(found.p[k]), float(found.sigma[k])
    half = INTERVAL * sigma  # the place in the file must be outside
    clear = gain.mean() > SURE * gain.std() / np.sqrt(len(gain)) and abs(lever) > half
    if clear and gain.mean() > GAIN * without.mean() and abs(lever) > LEAST:
        jet = best[1].removeprefix("lever_")
        text = f"jet {jet} pushes {1e3 * abs(lever):.0f} mm (+- {1e3 * half:.0f}) beside its place"
        yield Suspicion("other-vehicle", f"{text} in the file: another vehicle, or it was rebuilt")
