"""A vehicle's law on the host of the twin, whose ticks stay rows of numbers."""

import math

import numpy as np

from sim_twin.twin import HOST, Twin
from testbed.core.compiled import settled
from testbed.core.rows import SETPOINT_WIDTH, References, States, setpoint_of
from testbed.core.types import HostInputs, HostOutputs, HostTick
from testbed.flight.flown_tick import AnyHostTick, FlownHostTick, states_of
from testbed.flight.guidance import Heard
from testbed.flight.tick_table import TICKS, make_host_table
from testbed.rig.fleet.exchange import attend
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
        self._to, self._room = twin.setpoints.rows([(HOST, self.name)]), ROOM
        self._who: tuple[bytes, tuple[str, ...]] = b"", ()  # numbers of those heard, and names
        self._attend = settled(attend)
        self._new_table()

    def _new_table(self) -> None:
        self._table, self._k = make_host_table(len(self._vehicles), self._room), 0

    def tick(self, t: float, armed: bool = True) -> AnyHostTick:
        """See `HostNode`."""
        self.take_over(t)
        by_hand = self.stick is not None or (self.pilot is not None and self.pilot.flies)
        if not armed or by_hand or self._fault is not None:
            return super().tick(t, armed)
        if self._k == TICKS:
            self._new_table()
        table, k, twin = self._table, self._k, self.twin
        heard = self._attend(twin.states.links, self._own, self._links, self._vehicles, table, k)
        if heard < 0:
            return super().tick(t, armed)
        own, guidance = table.own[k].tolist(), self.guidance
        words = self._link.messages() if guidance.message_size else {}
        told = Heard(self._names_of(table.vehicles[k, :heard]), table.states[k, :heard], words)
        try:
            row = guidance.step_row(t + self._ahead, own, told)
        except Exception as error:  # after any exception of a law the vehicles are stopped
            self.fail(error)
            return super().tick(t, armed)
        if not is_number(row):
            self.fail(None)
            return super().tick(t, armed)
        twin.setpoints.send(self._to, twin.now, row)
        message, filtered = guidance.message, guidance.filtered
        if message is not None:
            self._link.broadcast(message)
        if message is not None or words:
            states = states_of(table, k, heard, self._names)
            inputs = HostInputs(t, States.struct(own), states, words)
            return HostTick(inputs, HostOutputs(t, setpoint_of(row), message, None, filtered))
        ahead = row[SETPOINT_WIDTH:].reshape(-1, References.width)
        if len(ahead) > self._room:
            self._room = 2 * len(ahead)
            self._new_table()
            heard = self._attend(
                twin.states.links, self._own, self._links, self._vehicles, self._table, 0
            )
            table, k = self._table, 0
        table.t[k], table.setpoints[k] = t, row[:SETPOINT_WIDTH]
        table.references[k, : len(ahead)], table.counts[k] = ahead, (heard, len(ahead))
        self._k = k + 1
        return FlownHostTick(table, k, self._names, own[0], filtered)

    def _names_of(self, vehicles: np.ndarray) -> tuple[str, ...]:
        """Names of vehicles by number; those of the tick before are kept."""
        numbers = vehicles.tobytes()
        if numbers != self._who[0]:
            self._who = numbers, tuple(self._names[one] for one in vehicles.tolist())
        return self._who[1]


def is_number(row: np.ndarray) -> bool:
    """Whether a setpoint is finite; only the newest reference of a trajectory is checked."""
    fx_or_x = 3 if len(row) == SETPOINT_WIDTH else 1 - References.width
    one, other = row[fx_or_x : fx_or_x + 2].tolist()
    return math.isfinite(one + other)
