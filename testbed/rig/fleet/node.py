"""A vehicle of the twin whose ticks stay rows of numbers."""

from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np

from sim_twin.board import Board
from sim_twin.twin import HOST, Twin, TwinThrusters
from testbed.core.bundle import Bundle
from testbed.core.codes import FaultReport
from testbed.core.compiled import with_fixed_types
from testbed.core.jets import JetHealth
from testbed.core.rows import References, States
from testbed.core.warned import Warned
from testbed.flight.agent import ALERT, Agent
from testbed.flight.barrier import WIDTH
from testbed.flight.flown_span import FlownRows
from testbed.flight.flown_tick import AnyTick, FlownTick
from testbed.flight.guidance import Guidance
from testbed.flight.loop import VehicleNode
from testbed.flight.tick_table import make_table
from testbed.rig.fleet.exchange import Incoming, VehiclePorts, deliver, receive

ROOM = 16, 8  # poses and references of a tick, at first


class TwinNode:
    """An agent on the twin, without injected faults, whose law is on the host."""

    def __init__(self, twin: Twin, agent: Agent, board: Board, node: VehicleNode) -> None:
        """Fly a vehicle of the twin.

        Args:
            twin: it flies on.
            agent: of the vehicle.
            board: its board.
            node: the same vehicle, which flies the ticks that are out of the ordinary.
        """
        self.name = node.name
        self._twin, self._agent, self._board, self._node = twin, agent, board, node
        self._body, self._names = twin.rows[self.name], twin.names
        self._others, self._room = len(twin.names) - 1, ROOM
        self._thrusters = TwinThrusters(twin, self.name)
        self._parts: tuple[Any, ...] = (None,) * 4  # of the twin, in `_ports`
        self._neighbours = np.zeros((self._others, WIDTH))  # see exchange.receive
        twin.states.widen(States.width)
        self._receive, self._deliver = with_fixed_types(receive), with_fixed_types(deliver)
        self._new_table()

    def _new_table(self) -> None:
        memory = self._agent.memory
        jets, rows = memory.begun.shape[0], memory.counters.holds.shape[0]
        self._table, self._k = make_table(jets, self._others, rows, self._room), 0
        self._flown = 0  # rows written; `tick` has yet to return the last one if it is `_k`
        self._rows = Bundle(self._table)

    def rows_free(self) -> int:
        """Ticks that may be flown ahead now, as far as this vehicle is concerned."""
        if self._agent.at_fault:
            return 0
        self._look()
        return len(self._table.records) - self._k

    @property
    def bundles(self) -> tuple[Bundle, Bundle, Bundle]:
        """Addresses of its VehiclePorts, its table, and the vehicle for `chain.see`."""
        return self._ports, self._rows, self._agent.vehicle

    @property
    def row(self) -> int:
        """The next row of its table."""
        return self._k

    def note_ticks(self, ticks: int, row: int, flags: list[float], openings: int) -> FlownRows:
        """Record ticks that compiled code has flown; `tick` may have to return the last one.

        Args:
            ticks: how many.
            row: of its table, the next one after them and the one more.
            flags: of the newest tick, see ticks.SpanBuffers.
            openings: of its valves.
        """
        rows = FlownRows(self._table, self._k, ticks, self._names, self._agent)
        self._k += ticks
        self._flown, self._flags = row, flags
        self._board.openings += openings
        return rows

    @property
    def pending(self) -> bool:
        """Whether the coming tick has been flown, and `tick` only returns it."""
        return self._k < self._flown

    def _look(self) -> None:
        """See to it that the table has a row to write to, and that the ports are the twin's."""
        if self._k == len(self._table.records):
            self._new_table()
        twin, (near, film, states, setpoints) = self._twin, self._parts
        if not (
            near is twin.near[self.name] and film is twin.cameras.film
            and states is twin.states.links and setpoints is twin.setpoints.links
        ):  # fmt: skip
            self._refresh()

    def _refresh(self) -> None:
        """Look at the twin's parts again: the vehicles in range, and arrays that have grown."""
        twin, agent, name = self._twin, self._agent, self.name
        near, barrier, memory = twin.near[name], agent.barrier, agent.memory
        incoming = Incoming(
            int(twin.setpoints.rows([(HOST, name)])[0]),
            twin.states.rows((one, name) for one in near),
            np.array([twin.rows[one] for one in near], np.int64),
            np.zeros((len(near), 2)) if barrier is None else barrier.neighbour_limits(near),
        )
        audience = twin.audience(name)  # may make room for new links
        film, states, setpoints = twin.cameras.film, twin.states.links, twin.setpoints.links
        self._parts = near, film, states, setpoints
        self._ports = Bundle(VehiclePorts(
            film, twin.cameras.markers[self._body], states, setpoints, incoming, audience,
            twin.gauges[self._body], agent.row, self._neighbours, memory.fixed, memory.times,
            memory.counters.holds, self._board.wires, agent.params.gains.period, agent.lead, ALERT,
        ))  # fmt: skip

    @property
    def guidance(self) -> Guidance | None:
        """See `VehicleNode`."""
        return None

    @property
    def jets(self) -> tuple[JetHealth, ...]:
        """See `VehicleNode`."""
        return self._agent.jets

    @property
    def warned(self) -> dict[str, Warned]:
        """See `Agent`."""
        return self._agent.warned

    def tick(
        self, t: float, armed: bool, fleet: FaultReport | None = None, *,
        end: bool = False, stay: bool = False,
    ) -> AnyTick:  # fmt: skip
        """See `VehicleNode`."""
        if self.pending:
            return self._tick(t, self._flags)
        twin, agent = self._twin, self._agent
        if end or stay or fleet is not None or twin.lab_fault() is not None:
            return self._node.tick(t, armed, fleet, end=end, stay=stay)
        self._look()
        while not self._receive(self._ports, self._rows, self._k, t, int(armed)):
            self._make_room()
        table, k = self._table, self._k
        seen, others, ahead = table.counts[k].tolist()
        samples, references = table.samples[k, :seen], table.references[k, :ahead]
        agent.step_row(samples, references, self._neighbours[:others])
        *flags, openings, full = self._deliver(self._ports, self._rows, k)
        self._board.openings += openings
        return self._tick(t, (*flags, full))

    def _tick(self, t: float, flags: Sequence[float]) -> FlownTick:
        """The newest row as a tick, after what it asks for; see exchange.deliver."""
        inhibit, fault, gate_fault, lands, looks, full = flags
        agent, k = self._agent, self._k
        self._k += 1
        if full:
            self._twin.states.make_room()
        if lands:
            self._thrusters.land()
        tick = FlownTick(self._table, k, t, agent, self._names, shut=inhibit != 0)
        inputs = partial(getattr, tick, "inputs")
        tick.fault = agent.notice(int(fault), int(gate_fault), bool(looks), inputs)
        return tick

    def _make_room(self) -> None:
        """A new table with more room for poses and references."""
        count, links = self._twin.cameras.film.tally[self._body], self._twin.setpoints.links
        poses, numbers = int(count[1] - count[2]), links.newest.shape[1]
        samples, references = self._room
        self._room = max(samples, 2 * poses), max(references, 1 + numbers // References.width)
        self._new_table()
