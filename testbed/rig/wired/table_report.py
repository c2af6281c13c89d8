"""The report of the twin's server after a flight."""

from bisect import bisect_right
from collections.abc import Sequence

import numpy as np
from msgspec import Struct

from sim_twin.plant import Touch
from testbed.metrics.afterwards import After, judge_after
from testbed.metrics.run_metrics import Consumption


class TableReport(Struct, frozen=True):
    """True states, contacts and valve edges of a flight."""

    released_ns: int | None  # the plant's time 0 on the monotonic clock; None: it never started
    t: list[float]  # of each exposure, in the plant's time [s]
    states: list[list[list[float]]]  # (n, v, 6)
    touches: list[Touch]
    impulse: dict[str, float]  # [N s]
    gas: dict[str, float]  # [kg]
    openings: dict[str, int]
    late_edges: dict[str, int]  # reported after the plant had passed their time
    edges: dict[str, list[tuple[int, int]]]  # monotonic [us], mask: all of them
    boards: list[str]
    left_as: dict[str, tuple[str, list[str]]]  # each board's state and faults at the end
    silence_ms: dict[str, float] = {}  # longest time of an armed board without a frame
    later_t: list[float] = []  # times in the minute after the last exposure [s]
    later_states: list[list[list[float]]] = []
    floats: dict[str, bool] = {}  # whether bearing air is on at the end
    # impulse [N s], gas [kg] and openings of each vehicle so far, at each exposure; (n, v, 3)
    spent: list[list[tuple[float, float, int]]] = []

    def spent_by(self, name: str, names: Sequence[str], end: float) -> Consumption:
        """Consumption until a time of the plant [s], as of the last exposure before it."""
        past = bisect_right(self.t, end)
        if past == 0 or len(self.spent) < past:
            return Consumption(self.impulse[name], self.gas[name], self.openings[name])
        return Consumption(*self.spent[past - 1][names.index(name)])

    def after(self, names: Sequence[str], end: float) -> After:
        """Judge the vehicles after a flight that ended at `end` in the plant's time [s]."""
        t = np.array([*self.t, *self.later_t])
        states = np.array([*self.states, *self.later_states]).reshape(-1, len(names), 6)
        floats = {name: self.floats.get(name, True) for name in names}
        return judge_after(names, t[t >= end], states[t >= end], self.touches, floats, end)
