"""A tick that is a row of a table; its structs are made for those who look at one."""

import numpy as np

from testbed.core.codes import FaultReport, Intervention
from testbed.core.records.kinds import SetpointKind
from testbed.core.rows import PoseSamples, References, States, setpoint_of
from testbed.core.types import (
    Health,
    HostInputs,
    HostOutputs,
    HostTick,
    Inputs,
    Outputs,
    Setpoint,
    State,
    Tick,
    Trajectory,
)
from testbed.flight.agent import Agent, taken
from testbed.flight.tick_table import HostTable, TickTable


class FlownTick:
    """One tick, a row of a table. It has what `Tick` has."""

    __slots__ = (
        "_inputs", "_outputs", "agent", "fault", "k", "names", "shut", "t", "table",
    )  # fmt: skip

    def __init__(
        self, table: TickTable, k: int, t: float, agent: Agent, names: list[str], *,
        shut: bool, fault: FaultReport | None = None,
    ) -> None:  # fmt: skip
        """A tick.

        Args:
            table: of its vehicle.
            k: its row.
            t: time of the tick [s].
            agent: that has flown it.
            names: of all vehicles, by number.
            shut: the valves had to stay shut.
            fault: that ends the run.
        """
        self.table, self.k, self.agent, self.names = table, k, agent, names
        self.t, self.shut, self.fault = t, shut, fault
        self._inputs: Inputs | None = None
        self._outputs: Outputs | None = None

    ended = False  # the flight goes on

    @property
    def tick(self) -> Tick:
        """The tick as structs."""
        return Tick(self.inputs, self.outputs)

    @property
    def inputs(self) -> Inputs:
        """See `Tick`."""
        if self._inputs is None:
            table, k = self.table, self.k
            row, (seen, others, _) = table.records[k].inputs, table.counts[k].tolist()
            t, supply, tank = float(row.t), float(row.supply_pressure), float(row.tank_pressure)
            self._inputs = Inputs(
                t,
                bool(row.armed),
                PoseSamples(table.samples[k, :seen].copy()),
                self._setpoint(),
                states_of(table, k, others, self.names),
                Health(t, supply, tank),
            )
        return self._inputs

    def _setpoint(self) -> Setpoint | None:
        row, rows = self.table.records[self.k].inputs.setpoint, self.table.references[self.k]
        until = float(row.valid_until)
        if row.kind == SetpointKind.TRAJECTORY:
            return Trajectory(References(rows[: self.table.counts[self.k, 2]].copy()), until)
        if row.kind == SetpointKind.DEMAND:
            return setpoint_of(np.array(row.tolist()))
        return None

    @property
    def outputs(self) -> Outputs:
        """See `Tick`."""
        if self._outputs is None:
            table, k, inputs = self.table, self.k, self.inputs
            record = table.records[k : k + 1].view(np.uint8).data
            self._outputs = self.agent.made(
                *taken(record), inputs, inputs.setpoint, self.fault,
                table.plans[k], table.holds[k], table.values[k], None,
            )  # fmt: skip
        return self._outputs


class FlownHostTick:
    """One tick of a law on the host, a row of a table. It has what `HostTick` has."""

    __slots__ = ("filtered", "k", "names", "own_t", "table")
    fault = None

    def __init__(
        self, table: HostTable, k: int, names: list[str], own_t: float,
        filtered: Intervention | None,
    ) -> None:  # fmt: skip
        """A tick in which the law has given a setpoint.

        Args:
            table: of the vehicle.
            k: its row.
            names: of all vehicles, by number.
            own_t: time of the vehicle's newest state [s].
            filtered: change of the reference model's force.
        """
        self.table, self.k, self.names = table, k, names
        self.own_t, self.filtered = own_t, filtered

    @property
    def tick(self) -> HostTick:
        """The tick as structs."""
        return HostTick(self.inputs, self.outputs)

    @property
    def t(self) -> float:
        """See `HostTick`."""
        return float(self.table.t[self.k])

    @property
    def inputs(self) -> HostInputs:
        """See `HostTick`."""
        table, k = self.table, self.k
        own = States.struct(table.own[k].tolist())
        return HostInputs(self.t, own, states_of(table, k, int(table.counts[k, 0]), self.names))

    @property
    def outputs(self) -> HostOutputs:
        """See `HostTick`."""
        table, k = self.table, self.k
        ahead = table.references[k, : int(table.counts[k, 1])]
        setpoint = setpoint_of(np.concatenate((table.setpoints[k], ahead.ravel())))
        return HostOutputs(self.t, setpoint, filtered=self.filtered)


def states_of(
    table: TickTable | HostTable, k: int, others: int, names: list[str]
) -> dict[str, State]:
    """The first `others` states of others in row `k`, by name."""
    whose = [names[one] for one in table.vehicles[k, :others].tolist()]
    return dict(zip(whose, map(States.struct, table.states[k, :others].tolist()), strict=True))


AnyTick = Tick | FlownTick
AnyHostTick = HostTick | FlownHostTick
