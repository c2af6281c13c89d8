"""All vehicles of the twin: flown ahead many ticks at a time, handed out tick by tick."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numba.core import config

from controllers.own_law import OwnLawParams
from sim_twin.plant import advance
from sim_twin.twin import Twin, exposures, observe
from testbed.config import Experiment
from testbed.core.bundle import Bundle
from testbed.core.code_address import CodeAddress
from testbed.core.compiled import settled
from testbed.flight import chain
from testbed.flight.tick_table import Array
from testbed.rig.fleet.exchange import hear, law_tick, say
from testbed.rig.fleet.host import TwinHost
from testbed.rig.fleet.node import TwinNode
from testbed.rig.fleet.ticks import (
    CLOCK,
    FRAME,
    FRAMES,
    HAPPENINGS,
    LAWS,
    MOST,
    TICKS,
    TOUCHES,
    Codes,
    FleetPorts,
    Flown,
    TwinPorts,
    fly_ticks,
)

AHEAD = 50  # ticks in one call, at most: an operator's stop waits for its end


class Fleet:
    """The vehicles and laws of a flight on the twin in which nothing needs Python at every tick."""

    def __init__(
        self, twin: Twin, nodes: list[TwinNode], hosts: list[TwinHost], period: float
    ) -> None:
        """Fly these together.

        Args:
            twin: without injected faults.
            nodes: its vehicles.
            hosts: their laws.
            period: of a tick [s].
        """
        self._twin, self._nodes, self._hosts, self._period = twin, nodes, hosts, period
        self._parts: tuple[Any, ...] = ()  # of the twin, in `_ports`
        self._codes: Codes | None = None
        self._fly = settled(fly_ticks)
        n, frames = len(nodes), 2 + int(AHEAD * (1.0 + period * twin.rate))
        self._frames = frames
        self._out = Flown(
            np.zeros(HAPPENINGS, np.int64), np.zeros(1), np.zeros(n, np.int64),
            np.zeros(n, np.int64), np.empty(frames), np.empty((frames, n, 6)),
            np.empty((AHEAD, n, 6)), np.zeros((n, 6)), np.zeros(n, np.int64), np.zeros(n),
            np.empty((AHEAD, n, 3)), np.empty((AHEAD, n, 5)),
        )  # fmt: skip
        self._flown = Bundle(self._out)
        self._first = self._until = self._k = 0  # ticks flown ahead, and the one handed out

    def begin(self, k: int, last: int) -> None:
        """Tick `k` comes next; fly it and more ahead, up to tick `last`, if that is possible now."""
        self._k = k
        if k == 0 or k < self._until:  # at the first tick the twin has nothing to do
            return
        times = [n * self._period for n in range(k, min(k + AHEAD, last))]
        turns = [host.ready(times) for host in self._hosts]
        count = min(len(one) for one in turns)
        if count == 0 or (count := min(count, *(node.ready() for node in self._nodes))) < 2:
            return
        out, twin = self._out, self._twin
        out.happened[:], out.openings[:], out.now[0] = 0, 0, twin.plant.t
        out.happened[FRAME], out.happened[MOST] = twin.frame, twin.cameras.most
        for v, (node, host) in enumerate(zip(self._nodes, self._hosts, strict=True)):
            out.rows[v], out.law_rows[v], out.model_t[v] = node.row, host.row, host.guidance.model_t
            out.turns[:count, v] = turns[v][:count]
        self._fly(self._fleet(), self._flown, k, count)
        self._note(k)

    def _note(self, first: int) -> None:
        """Tell everything that was in Python before what `fly_ticks` has done."""
        out, twin, happened = self._out, self._twin, self._out.happened.tolist()
        frames = happened[FRAMES]
        twin.came_to(float(out.now[0]), out.times[:frames], out.seen[:frames].copy())
        twin.cameras.most = happened[MOST]
        twin.plant.came_to(twin.now, happened[TOUCHES])
        ticks, laws = happened[TICKS], happened[LAWS]
        rows, openings, said = out.rows.tolist(), out.openings.tolist(), out.said.tolist()
        for v, node in enumerate(self._nodes):
            node.flew(rows[v], said[v], openings[v])
        for v, host in enumerate(self._hosts):
            host.flew(out.answers[: ticks + (v < laws), v].tolist())
        self._first, self._until = first, first + ticks + happened[CLOCK]

    def _fleet(self) -> Bundle:
        """The vehicles, laws and parts of the twin as they are now."""
        twin, nodes = self._twin, [node.bundles for node in self._nodes]
        laws = [host.bundles for host in self._hosts]
        parts = (
            twin.cameras.film, twin.states.links, twin.setpoints.links, twin.messages.links,
            nodes, laws,
        )  # fmt: skip
        if not self._same(parts):
            plant, cameras = twin.plant, twin.cameras
            ports = TwinPorts(
                twin.rate, twin.phase, plant.fleet, plant.played(), cameras.film, cameras.optics,
                cameras.own, twin.states.links, twin.setpoints.links, twin.messages.links,
                twin.tanks, plant.used, twin.gauges, plant.x,
            )  # fmt: skip
            if self._codes is None:
                self._codes = codes_of(ports, nodes[0], laws[0])
            self._ports = Bundle(FleetPorts(
                self._codes, ports, self._period, *nodes[0], *laws[0],
                np.array(nodes, np.int64), np.array(laws, np.int64),
            ))  # fmt: skip
            self._parts = parts
        return self._ports

    def _same(self, parts: tuple[Any, ...]) -> bool:
        """Whether the fleet was made of these parts."""
        return bool(self._parts) and all(
            one == other if isinstance(one, list) else one is other
            for one, other in zip(self._parts, parts, strict=True)
        )

    @property
    def pending(self) -> bool:
        """Whether the tick handed out now was flown ahead."""
        return self._k < self._until

    @property
    def now(self) -> float:
        """Time of the tick handed out now [s]."""
        return self._k * self._period if self.pending else self._twin.now

    @property
    def truth(self) -> Array:
        """True states at that time, (v, 6)."""
        return self._out.truth[self._k - self._first] if self.pending else self._twin.plant.x

    def end(self) -> None:
        """The flight is over; all that was flown ahead has been handed out."""
        self._until = 0


def codes_of(
    ports: TwinPorts, node: tuple[Bundle, Bundle, Bundle], law: tuple[Bundle, Bundle, Bundle]
) -> Codes:
    """Machine code for a fleet like this one."""
    times, seen, turn = np.empty(0), np.empty((0, *ports.x.shape)), (0.0, 0.0, 0.0)
    samples, references, others = np.empty((0, 4)), np.empty((0, 10)), np.empty((0, 6))
    own, table, chained = node
    law_ports, law_table, model = law
    return Codes(
        CodeAddress(exposures, (ports.rate, ports.phase, 0, 0.0, times)),
        CodeAddress(advance, (ports.plant, ports.pulses, 0, 0.0, times, seen)),
        CodeAddress(observe, (
            ports.film, ports.optics, times, seen, ports.shown, ports.states, ports.setpoints,
            ports.messages, ports.tanks, ports.used, ports.pressures, 0.0,
        )),
        CodeAddress(hear, (own, table, 0, 0.0, 1)),
        CodeAddress(chain.step, (chained, samples, references, others)),
        CodeAddress(say, (own, table, 0)),
        CodeAddress(law_tick, (law_ports, law_table, 0, model, 0.0, turn, 0.0)),
    )  # fmt: skip


def make_fleet(
    experiment: Experiment, twin: Twin, vehicles: Sequence[object], hosts: Sequence[object]
) -> Fleet | None:
    """The fleet of a flight; None: it must be flown tick by tick.

    That is so with injected faults, forks, laws on board, a radio of limited range and reference
    bodies, and with a user's own law, which may hang: a stop must not wait for 50 of its ticks.
    """
    nodes = [one for one in vehicles if isinstance(one, TwinNode)]
    laws = [one for one in hosts if isinstance(one, TwinHost)]
    every = len(nodes) == len(laws) == len(experiment.vehicles)
    own, fixed = isinstance(experiment.controller, OwnLawParams), experiment.table.lab.mocap
    if not every or own or experiment.forks or twin.reach is not None or fixed.reference:
        return None
    if config.DISABLE_JIT:
        return None
    return Fleet(twin, nodes, laws, experiment.flight.jet_period_s)
