"""All vehicles of the twin, many ticks at a time."""

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from numba.core import config

from controllers.catalogue import UsersLaw
from sim_twin.plant import advance
from sim_twin.twin import Twin, exposures, observe
from testbed.config import Experiment
from testbed.config.thresholds import vehicle_silent_s
from testbed.core.bundle import Bundle
from testbed.core.code_address import CodeAddress
from testbed.core.compiled import with_fixed_types
from testbed.flight import chain
from testbed.flight.barrier import WIDTH
from testbed.flight.flown_span import FlownSpan
from testbed.flight.reference_model import code_for
from testbed.rig.fleet.exchange import deliver, law_tick, receive
from testbed.rig.fleet.host import TwinHost
from testbed.rig.fleet.node import TwinNode
from testbed.rig.fleet.ticks import (
    FRAME,
    FRAMES,
    LAWS,
    MOST,
    PROGRESS,
    TICKS,
    TOUCHES,
    Codes,
    FleetPorts,
    SpanBuffers,
    TwinPorts,
    fly_ticks,
)

# An operator's stop waits for the end of a call, so a call has at most this many steps of all
# vehicles together. The ticks that follow from it are limited, too.
STEPS_PER_CALL, FEWEST_TICKS, MOST_TICKS = 300, 25, 100


class Fleet:
    """The vehicles and laws of a flight on the twin in which nothing needs Python at every tick."""

    def __init__(
        self,
        twin: Twin,
        nodes: list[TwinNode],
        hosts: list[TwinHost],
        period: float,
        silent_s: float,
    ) -> None:
        """Fly these together.

        Args:
            twin: without injected faults.
            nodes: its vehicles.
            hosts: their laws.
            period: of a tick [s].
            silent_s: see `loop.host_fault` [s].
        """
        self._silent_s = silent_s
        self._twin, self._nodes, self._hosts, self._period = twin, nodes, hosts, period
        self._parts: tuple[Any, ...] = ()  # what `_ports` was made of
        self._ports: Bundle | None = None
        self._codes: Codes | None = None  # for bundles of these kinds
        self._kinds: tuple[Any, ...] = ()
        self._fly_ticks = with_fixed_types(fly_ticks)
        n = len(nodes)
        self._ahead = ahead = max(FEWEST_TICKS, min(MOST_TICKS, STEPS_PER_CALL // n))
        frames = 2 + int(ahead * (1.0 + period * twin.rate))
        self._out = SpanBuffers(
            np.zeros(PROGRESS, np.int64), np.zeros(1), np.zeros(n, np.int64),
            np.zeros(n, np.int64), np.empty(frames), np.empty((frames, n, 6)),
            np.empty((ahead, n, 6)), np.zeros((n, 6)), np.zeros(n, np.int64), np.zeros(n),
            np.empty((ahead, n, 3)), np.empty((ahead, n, 5)),
        )  # fmt: skip
        self._flown = Bundle(self._out)

    def fly(self, k: int, last: int) -> FlownSpan | None:
        """Fly ticks from number `k` on, up to `last`, if that is possible now.

        The tick after them may have begun: then the nodes have the rest of it.
        """
        if not self._twin.plant.valves_healthy:
            return None
        times = [n * self._period for n in range(k, min(k + self._ahead, last))]
        if (free := min(node.rows_free() for node in self._nodes)) == 0:
            return None
        pairs = zip(self._nodes, self._hosts, strict=True)
        turns = [host.turns_ahead(times[:free], node.row) for node, host in pairs]
        if (count := min(len(one) for one in turns)) == 0:
            return None
        out, twin = self._out, self._twin
        out.progress[:], out.openings[:], out.now[0] = 0, 0, twin.plant.t
        out.progress[FRAME], out.progress[MOST] = twin.frame, twin.cameras.most
        for v, (node, host) in enumerate(zip(self._nodes, self._hosts, strict=True)):
            out.rows[v], out.law_rows[v], out.model_t[v] = node.row, host.row, host.guidance.model_t
            out.turns[:count, v] = turns[v][:count]
        if (fleet := self._fleet()) is None:
            return None
        self._fly_ticks(fleet, self._flown, k, count)
        return self._noted(times)

    def _noted(self, times: list[float]) -> FlownSpan:
        """Tell everything in Python what `fly_ticks` has done."""
        out, twin, progress = self._out, self._twin, self._out.progress.tolist()
        frames, ticks = progress[FRAMES], progress[TICKS]
        twin.note_window(float(out.now[0]), out.times[:frames], out.seen[:frames].copy())
        twin.cameras.most = progress[MOST]
        twin.plant.note_window(twin.now, progress[TOUCHES])
        rows, openings, flags = out.rows.tolist(), out.openings.tolist(), out.flags.tolist()
        vehicles = {
            node.name: node.note_ticks(ticks, rows[v], flags[v], openings[v])
            for v, node in enumerate(self._nodes)
        }
        hosts = {
            host.name: host.note_ticks(
                ticks, out.answers[: ticks + (v < progress[LAWS]), v].tolist()
            )
            for v, host in enumerate(self._hosts)
        }
        return FlownSpan(times[:ticks], vehicles, hosts, out.truth[:ticks].copy())

    def _fleet(self) -> Bundle | None:
        """The vehicles, laws and parts of the twin as they are now; None: not all of one kind."""
        twin, nodes = self._twin, [node.bundles for node in self._nodes]
        laws = [host.bundles for host in self._hosts]
        if (parts := (twin.sensor_ports, nodes, laws)) != self._parts:
            self._kinds = self._kinds or kinds_of(nodes[0], laws[0])
            if any(kinds_of(*pair) != self._kinds for pair in zip(nodes, laws, strict=True)):
                return None
            plant, cameras = twin.plant, twin.cameras
            ports = TwinPorts(
                twin.rate, twin.phase, plant.arrays, plant.played(), twin.sensor_ports, cameras.own,
                cameras.film.poses.shape[1], plant.x,
            )  # fmt: skip
            if self._codes is None:
                self._codes = codes_of(ports, nodes[0], laws[0])
            self._ports = Bundle(FleetPorts(
                self._codes, Bundle(ports), self._period, self._silent_s,
                *nodes[0], *laws[0],
                np.array(nodes, np.int64), np.array(laws, np.int64),
            ))  # fmt: skip
            self._parts = parts
        return self._ports

    @property
    def pending(self) -> bool:
        """Whether the coming tick has begun, see `fly`."""
        return self._nodes[0].pending


def kinds_of(node: Iterable[Bundle], law: Iterable[Bundle]) -> tuple[Any, ...]:
    """What code for a vehicle and its law depends on; numba has one object for equal types."""
    return tuple(id(one.kind) for one in (*node, *law))


def codes_of(
    ports: TwinPorts, node: tuple[Bundle, Bundle, Bundle], law: tuple[Bundle, Bundle, Bundle]
) -> Codes:
    """Machine code for a fleet like this one."""
    times, seen, turn = np.empty(0), np.empty((0, *ports.x.shape)), (0.0, 0.0, 0.0)
    samples, references, others = np.empty((0, 4)), np.empty((0, 10)), np.empty((0, WIDTH))
    own, table, chained = node
    law_ports, law_table, model = law
    code = code_for(model)
    return Codes(
        CodeAddress(exposures, (ports.rate, ports.phase, 0, 0.0, times)),
        CodeAddress(advance, (ports.plant, ports.pulses, 0, 0.0, times, seen)),
        CodeAddress(observe, (ports.sensors, times, seen, ports.shown, 0.0)),
        CodeAddress(receive, (own, table, 0, 0.0, 1)),
        CodeAddress(chain.see, (chained, samples)),
        CodeAddress(chain.act, (chained, samples, references, others)),
        CodeAddress(deliver, (own, table, 0)),
        CodeAddress(law_tick, (law_ports, law_table, 0, code, model, 0.0, turn, 0.0)),
        code,
    )  # fmt: skip


def make_fleet(
    experiment: Experiment, twin: Twin, vehicles: Sequence[object], hosts: Sequence[object]
) -> Fleet | None:
    """The fleet of a flight; None: it must be flown tick by tick.

    That is so with injected faults, forks, laws on board, a radio of limited range and reference
    bodies, and with a user's law, which may hang: a stop must not wait for many of its ticks. It is
    also so without the compiler (NUMBA_DISABLE_JIT).
    """
    nodes = [one for one in vehicles if isinstance(one, TwinNode)]
    laws = [one for one in hosts if isinstance(one, TwinHost)]
    every = len(nodes) == len(laws) == len(experiment.vehicles)
    own, fixed = isinstance(experiment.controller, UsersLaw), experiment.table.lab.mocap
    if not every or own or experiment.forks or twin.reach is not None or fixed.reference:
        return None
    if vars(config)["DISABLE_JIT"]:
        return None
    silent_s = vehicle_silent_s(experiment.table, experiment.flight)
    return Fleet(twin, nodes, laws, experiment.flight.jet_period_s, silent_s)
