"""A vehicle's law on the host of the twin, whose ticks stay rows of numbers."""

from collections.abc import Iterable, Sequence
from itertools import islice
from typing import Any

import numpy as np

from sim_twin.twin import HOST, Twin
from testbed.core.bundle import Bundle
from testbed.core.compiled import with_fixed_types
from testbed.core.rows import SETPOINT_WIDTH, References, States, is_finite, setpoint_of
from testbed.core.types import HostInputs, HostOutputs, HostTick
from testbed.flight.flown_span import FlownHostRows
from testbed.flight.flown_tick import AnyHostTick, FlownHostTick, states_of
from testbed.flight.guidance import Received
from testbed.flight.reference_model import code_for
from testbed.flight.tick_table import make_host_table
from testbed.rig.fleet.exchange import DECLINED, SENT, HostPorts, attend, law_tick
from testbed.rig.forked import ForkedHost

ROOM = 8  # references of a setpoint, at first


class TwinHost(ForkedHost):
    """The law of one vehicle; ticks that are out of the ordinary are those of `HostNode`."""

    twin: Twin  # where the links are

    def listen(self, twin: Twin) -> None:
        """Find the links, before the flight."""
        self.twin, self._names = twin, twin.names
        others = [one for one in twin.names if one != self.name]
        self._own = int(twin.states.rows([(self.name, HOST)])[0])
        self._links = twin.states.rows((one, HOST) for one in others)
        self._vehicles = np.array([twin.rows[one] for one in others], np.int64)
        self._parts: tuple[Any, ...] = (None,) * 3  # links and model when `_ports` was made
        self._known = np.zeros(0, np.int64)  # the vehicles that the model is made for
        self._to, self._room = twin.setpoints.rows([(HOST, self.name)]), ROOM
        self._who: tuple[bytes, tuple[str, ...]] = b"", ()  # numbers of the others, and names
        self._attend, self._law_tick = with_fixed_types(attend), with_fixed_types(law_tick)
        self._new_table()

    def _new_table(self) -> None:
        self._table, self._k = make_host_table(len(self._vehicles), self._room), 0
        self._answer: list[float] | None = None  # at the coming tick, if it has been flown
        self._rows = Bundle(self._table)

    def turns_ahead(self, times: Iterable[float], row: int) -> list[tuple[float, float, float]]:
        """The turns of the law's model at ticks that may be flown ahead now.

        Args:
            times: of the next ticks [s].
            row: the next one of the vehicle's table. The law's table begins anew with it: the log
                takes the rows of both together.
        """
        waits = self.later or self._fault is not None or self.stick is not None
        if waits or (self.pilot is not None and self.pilot.flies) or self.guidance.model is None:
            return []
        if self._k == len(self._table.t) or self._k > row:
            self._new_table()
        if not self._refresh():
            return []
        rows = len(self._table.t) - self._k
        return self.guidance.turns(t + self._ahead for t in islice(times, rows))

    @property
    def bundles(self) -> tuple[Bundle, Bundle, Bundle]:
        """Addresses of its HostPorts, its table and the law's model."""
        assert self.guidance.model is not None
        return self._ports, self._rows, self.guidance.model

    @property
    def row(self) -> int:
        """The next row of its table."""
        return self._k

    def note_ticks(self, ticks: int, answers: list[list[float]]) -> FlownHostRows:
        """Note the law's answers at ticks that were flown, and perhaps at one more, for `tick`.

        Args:
            ticks: how many.
            answers: see ticks.SpanBuffers.
        """
        rows = FlownHostRows(self._table, self._k, ticks, self._names)
        for i, (_, dfx, dfy, hazard, _) in enumerate(answers[:ticks]):
            self.guidance.advanced(self._who[1], dfx, dfy, int(hazard))
            if (filtered := self.guidance.filtered) is not None:
                rows.notes[i] = filtered
        self._k += ticks
        self._answer = answers[-1] if len(answers) > ticks else None
        return rows

    def _receive(self) -> int:
        """Write the states received into the next row of the table; see `exchange.attend`."""
        self._refresh()
        return self._attend(self._ports, self._rows, self._k)

    def _refresh(self) -> bool:
        """Make `_ports` again if links or the model are others; whether the model is the same."""
        states, setpoints, model = self._parts
        twin, new = self.twin, self.guidance.model
        same = model is new and model is not None
        if not (same and states is twin.states.links and setpoints is twin.setpoints.links):
            states, setpoints = self.twin.states.links, self.twin.setpoints.links
            self._parts = states, setpoints, new
            self._ports = Bundle(HostPorts(
                states, self._own, self._links, self._vehicles, setpoints, self._to, self._known,
            ))  # fmt: skip
        return same

    def _compiled_tick(self, t: float) -> FlownHostTick | None:
        """A tick in one compiled call; None: it has not begun, and `tick` flies it."""
        guidance = self.guidance
        turn = next(iter(guidance.turns((t + self._ahead,))), None)
        if turn is None or t != self.twin.now or not self._refresh():
            return None
        model = guidance.model
        assert model is not None  # it turns
        found, changed, full = self._law_tick(
            self._ports, self._rows, self._k, code_for(model), model, guidance.model_t, turn, t
        )
        return None if found == DECLINED else self._answered((found, *changed, full))

    def _answered(self, answer: Sequence[float]) -> FlownHostTick | None:
        """The tick in which the law has advanced its model; see exchange.law_tick."""
        found, dfx, dfy, hazard, full = answer
        guidance, table, k = self.guidance, self._table, self._k
        guidance.advanced(self._who[1], dfx, dfy, int(hazard))
        if found != SENT:
            self.fail(None)
            return None
        if full:
            self.twin.setpoints.make_room()
        self._k = k + 1
        return FlownHostTick(table, k, self._names, float(table.own[k, 0]), guidance.filtered)

    def tick(self, t: float, armed: bool = True) -> AnyHostTick:
        """See `HostNode`, which flies all ticks that are not ordinary."""
        if (answer := self._answer) is not None:
            self._answer = None
            return self._answered(answer) or super().tick(t, armed)
        self.take_over(t)
        by_hand = self.stick is not None or (self.pilot is not None and self.pilot.flies)
        if not armed or by_hand or self._fault is not None:
            return super().tick(t, armed)
        if self._k == len(self._table.t):
            self._new_table()
        return self._compiled_tick(t) or self._python_tick(t) or super().tick(t, armed)

    def _python_tick(self, t: float) -> AnyHostTick | None:
        """A tick of a law that Python has to call; None if there is no setpoint."""
        count = self._receive()
        if count < 0:
            return None
        table, k, guidance = self._table, self._k, self.guidance
        own = table.own[k].tolist()
        words = self._link.messages() if guidance.message_size else {}
        if self._fault is not None:
            return None
        self._known = table.vehicles[k, :count].copy()
        received = Received(self._names_of(self._known), table.states[k, :count], words)
        try:
            row = guidance.step_row(t + self._ahead, own, received)
        except Exception as error:  # after any exception of a law the vehicles are stopped
            self.fail(error)
            return None
        if not is_finite(row):
            self.fail(None)
            return None
        self.twin.setpoints.send(self._to, self.twin.now, row)
        message, filtered = guidance.message, guidance.filtered
        if message is not None:
            self._link.broadcast(message)
        if message is not None or words:
            states = states_of(table, k, count, self._names)
            inputs = HostInputs(t, States.struct(own), states, words)
            return HostTick(inputs, HostOutputs(t, setpoint_of(row), message, None, filtered))
        return self._kept(t, row, count)

    def _kept(self, t: float, row: np.ndarray, count: int) -> FlownHostTick:
        """The tick with its setpoint in the table, beside what `_receive` has written there."""
        ahead = row[SETPOINT_WIDTH:].reshape(-1, References.width)
        if len(ahead) > self._room:
            self._room = 2 * len(ahead)
            self._new_table()
            count = self._receive()
        table, k = self._table, self._k
        table.t[k], table.setpoints[k] = t, row[:SETPOINT_WIDTH]
        table.references[k, : len(ahead)], table.counts[k] = ahead, (count, len(ahead))
        self._k = k + 1
        return FlownHostTick(table, k, self._names, float(table.own[k, 0]), self.guidance.filtered)

    def _names_of(self, vehicles: np.ndarray) -> tuple[str, ...]:
        """Names of vehicles by number; those of the tick before are kept."""
        numbers = vehicles.tobytes()
        if numbers != self._who[0]:
            self._who = numbers, tuple(self._names[one] for one in vehicles.tolist())
        return self._who[1]
