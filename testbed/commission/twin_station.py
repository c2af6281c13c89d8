"""The twin as a station. The person who carries vehicles and hears valves is simulated, too."""

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from firmware_interface.limits import config_hash, limits_of
from sim_twin.randomness import stream
from sim_twin.twin import Twin, TwinPoses
from testbed.commission.cameras import Mark
from testbed.commission.station import BoardFacts
from testbed.config import Experiment
from testbed.core.types import Health, Pose, PoseSample, ValveCommand

MISPLACED = 0.01, 0.03  # error of a person who places a vehicle, one standard deviation [m, rad]
SPARE_S = 0.1  # from the end of a pulse to the end of its plan
STARTED_S = 0.2  # until the cameras' first poses have arrived


class TwinStation:
    """The vehicles of an experiment on the twin, standing on the table without bearing air.

    Args:
        experiment: as it really is, with the faults that it injects.
        believed: as the lab's files say; None: the same.
        agree: asks whether something may move; None: nothing is asked.
    """

    carries = listens = True

    def __init__(
        self, experiment: Experiment, believed: Experiment | None = None,
        agree: Callable[[str], bool] | None = None,
    ) -> None:  # fmt: skip
        self._agree = agree
        setups = experiment.vehicles
        self.believed = believed or experiment
        self.twin = Twin(
            {name: setup.model for name, setup in setups.items()},
            {name: Pose(*setup.start) for name, setup in setups.items()},
            experiment.table, {}, experiment.seed, injections=experiment.inject,
        )  # fmt: skip
        self._models = {name: setup.model for name, setup in setups.items()}
        self._poses = {name: TwinPoses(self.twin, name) for name in setups}
        self._hand = stream(experiment.seed, "hand")
        self._openings = dict.fromkeys(setups, 0)
        self._seq = 0
        for name in setups:
            self.bearing(name, on=False)
        self.wait(STARTED_S)

    @property
    def now(self) -> float:
        """See `Station`."""
        return self.twin.now

    def agree(self, what: str) -> bool:
        """See `Station`."""
        return self._agree is None or self._agree(what)

    def wait(self, seconds: float) -> None:
        """See `Station`."""
        self.twin.wait_until(self.twin.now + seconds)

    def poses(self) -> Mapping[str, Sequence[PoseSample]]:
        """See `Station`."""
        return {name: source.samples() for name, source in self._poses.items()}

    def board(self, name: str) -> BoardFacts:
        """See `Station`. A board of the twin is built for the vehicle that it drives."""
        built = config_hash(limits_of(self._models[name]))
        wanted = config_hash(limits_of(self.believed.vehicles[name].model))
        if built != wanted:
            trouble = f"built with limits {built:08x}, the vehicle file gives {wanted:08x}"
            return BoardFacts("", trouble)
        return BoardFacts(f"the twin's model, limits {built:08x}")

    def health(self, name: str) -> Health:
        """See `Station`."""
        return self.twin.health(name)

    def bearing(self, name: str, *, on: bool) -> None:
        """See `Station`."""
        plant = self.twin.plant
        k = plant.vehicle_of_board(self.twin.rows[name])
        if on:
            plant.lift(k)
        else:
            plant.land(k)

    def fire(self, name: str, jet: int, seconds: float) -> float:
        """See `Station`."""
        board = self.twin.plant.boards[name]
        self._openings[name], self._seq = board.openings, self._seq + 1
        times = [0] * len(self._models[name].jets)
        on = [round(1e6 * seconds) if k == jet else 0 for k in range(len(times))]
        now = self.twin.now
        board.apply(ValveCommand(self._seq, now, now + seconds + SPARE_S, tuple(on), tuple(times)))
        return now

    def clicked(self, name: str, jet: int) -> bool:
        """See `Station`."""
        return self.twin.plant.boards[name].openings > self._openings[name]

    def carry(self, name: str, mark: Mark) -> bool:
        """See `Station`."""
        place, turn = MISPLACED
        off = self._hand.standard_normal(3) * (place, place, turn)
        self.twin.plant.x[self.twin.rows[name]] = [*(np.array(mark) + off), 0.0, 0.0, 0.0]
        self.wait(STARTED_S)
        return True


def fastest(twin: Twin) -> float:
    """Largest true speed of any vehicle so far [m/s]."""
    return max(
        (float(np.hypot(s[..., 3], s[..., 4]).max()) for s in twin.seen if s.size), default=0.0
    )
