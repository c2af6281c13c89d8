"""A tick that is a row of a table; its structs are made for those who look at one."""

import numpy as np

from testbed.core.codes import FaultReport
from testbed.core.records.kinds import SetpointKind
from testbed.core.rows import PoseSamples, References, States
from testbed.core.types import (
    Demand,
    Health,
    Inputs,
    Outputs,
    Setpoint,
    Trajectory,
)
from testbed.flight.agent import Agent, taken
from testbed.flight.tick_table import TickTable


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
    def inputs(self) -> Inputs:
        """See `Tick`."""
        if self._inputs is None:
            table, k = self.table, self.k
            told, (seen, heard, _) = table.records[k].told, table.counts[k].tolist()
            names = [self.names[one] for one in table.vehicles[k, :heard].tolist()]
            states = map(States.struct, table.states[k, :heard].tolist())
            t, supply, tank = float(told.t), float(told.supply_pressure), float(told.tank_pressure)
            self._inputs = Inputs(
                t,
                bool(told.armed),
                PoseSamples(table.samples[k, :seen].copy()),
                self._setpoint(),
                dict(zip(names, states, strict=True)),
                Health(t, supply, tank),
            )
        return self._inputs

    def _setpoint(self) -> Setpoint | None:
        told, rows = self.table.records[self.k].told.setpoint, self.table.references[self.k]
        until = float(told.valid_until)
        if told.kind == SetpointKind.TRAJECTORY:
            return Trajectory(References(rows[: self.table.counts[self.k, 2]].copy()), until)
        if told.kind == SetpointKind.DEMAND:
            parts = told.t, told.fx, told.fy, told.theta, told.omega, told.alpha
            return Demand(*map(float, parts), until)
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
