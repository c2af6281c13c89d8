"""A twin that continues a run of bench or table: up to the fork its inputs come from the log.

At each tick before the fork chain and law get the inputs of the log, which restores their memory.
Their plans go to the twin's boards and their messages to its radio, and the twin's vehicles are put
where the estimate says. After that tick the inputs are the twin's.
"""

from collections.abc import Iterable, Mapping, Sequence
from functools import partial

from sim_twin.twin import Twin, TwinHostLink, TwinPoses, TwinThrusters, TwinVehicleLink
from testbed.config import Experiment
from testbed.core.codes import FaultReport
from testbed.core.error import TestbedError
from testbed.core.ports import HostLink
from testbed.core.types import (
    Health,
    HostInputs,
    HostTick,
    LawMessage,
    PoseSample,
    Setpoint,
    State,
    Tick,
    Vitals,
)
from testbed.flight.loop import Chain, VehicleNode
from testbed.rig.twin import TwinRig, make_twin

History = Mapping[str, list[Tick]]
HostTicks = Mapping[str, list[HostTick]]


def make_resumed(ticks: Iterable[tuple[str, Tick | HostTick]], experiment: Experiment) -> TwinRig:
    """The twin rig; `ticks` of vehicles and hosts before the fork, in order.

    Raises:
        TestbedError: a tick is missing.
    """
    vehicles: dict[str, list[Tick]] = {name: [] for name in experiment.vehicles}
    hosts: dict[str, list[HostTick]] = {name: [] for name in experiment.vehicles}
    for name, tick in ticks:
        if isinstance(tick, HostTick):
            hosts[name].append(tick)
        else:
            vehicles[name].append(tick)
    period = experiment.flight.jet_period_s
    streams: list[tuple[str, Sequence[Tick | HostTick]]] = [*vehicles.items(), *hosts.items()]
    for name, found in streams:
        for k, tick in enumerate(found):
            if abs(tick.inputs.t - k * period) > 0.5 * period:
                raise TestbedError(
                    where="fork", expected=f"every tick of {name} in the log",
                    found=f"none at {k * period:g} s",
                )  # fmt: skip
    return make_twin(experiment, partial(_node, vehicles, period), partial(_link, hosts, period))


def _node(history: History, period: float, twin: Twin, name: str, chain: Chain) -> VehicleNode:
    ports = ResumedVehicle(twin, name, history[name], period)
    return ResumedNode(name, chain, ports, ports, ports, ports.vitals)


def _link(ticks: HostTicks, period: float, twin: Twin, name: str) -> HostLink:
    return ResumedHost(twin, name, ticks[name], period)


class ResumedNode(VehicleNode):
    """A node whose arming is that of the log before the fork."""

    def tick(
        self, t: float, armed: bool, fleet: FaultReport | None = None, *,
        end: bool = False, stay: bool = False,
    ) -> Tick:  # fmt: skip
        """See `VehicleNode`."""
        ports = self._poses
        assert isinstance(ports, ResumedVehicle)
        then = ports.then
        if then is None:
            return super().tick(t, armed, fleet, end=end, stay=stay)
        tick = super().tick(then.inputs.t, then.inputs.armed)
        ports.put(tick)
        return tick


class ResumedVehicle:
    """A vehicle's ports: inputs of the log before the fork, outputs to the twin."""

    def __init__(self, twin: Twin, name: str, ticks: list[Tick], period: float) -> None:
        self._twin, self._row, self._ticks, self._period = twin, twin.rows[name], ticks, period
        self._poses, self._board = TwinPoses(twin, name), TwinThrusters(twin, name)
        self._link, self._own = TwinVehicleLink(twin, name), partial(twin.vitals, name)
        self.apply, self.land = self._board.apply, self._board.land
        self.publish, self.broadcast = self._link.publish, self._link.broadcast

    @property
    def then(self) -> Tick | None:
        """This tick in the log; None: it is after the fork."""
        k = round(self._twin.now / self._period)
        return self._ticks[k] if k < len(self._ticks) else None

    def put(self, tick: Tick) -> None:
        """Put the twin's vehicle where the estimate says, with as much gas."""
        plant, state, now = self._twin.plant, tick.outputs.state, self._twin.now
        plant.touches.clear()
        if state is not None:
            pose, twist, ago = state.pose, state.twist, state.t - now
            plant.x[self._row] = (
                pose.x - ago * twist.vx, pose.y - ago * twist.vy, pose.theta - ago * twist.omega,
                twist.vx, twist.vy, twist.omega,
            )  # fmt: skip
        gas, full = plant.parameters.gas[self._row], plant.parameters.tank_pressure[self._row]
        if (tank := tick.inputs.health.tank_pressure) > 0.0:
            plant.used[self._row] = gas * min(1.0, max(0.0, 1.0 - tank / full))

    def samples(self) -> Sequence[PoseSample]:
        """See `PoseSource`."""
        seen = self._poses.samples()  # of the log's time the twin's are dropped
        return seen if self.then is None else self.then.inputs.samples

    def setpoint(self) -> Setpoint | None:
        """See `VehicleLink`."""
        return self._link.setpoint() if self.then is None else self.then.inputs.setpoint

    def neighbours(self) -> dict[str, State]:
        """See `VehicleLink`."""
        return self._link.neighbours() if self.then is None else self.then.inputs.neighbours

    def messages(self) -> dict[str, LawMessage]:
        """See `VehicleLink`."""
        return self._link.messages() if self.then is None else self.then.inputs.messages

    def health(self) -> Health:
        """See `Thrusters`."""
        return self._board.health() if self.then is None else self.then.inputs.health

    def vitals(self) -> Vitals:
        """See `Vitals`."""
        return self._own() if self.then is None else self.then.inputs.vitals


class ResumedHost:
    """The host's link of one vehicle: inputs of the log before the fork, outputs to the twin."""

    def __init__(self, twin: Twin, name: str, ticks: list[HostTick], period: float) -> None:
        self._twin, self._ticks, self._period = twin, ticks, period
        self._link = TwinHostLink(twin, name)
        self.publish, self.broadcast = self._link.publish, self._link.broadcast

    @property
    def _then(self) -> HostInputs | None:
        k = round(self._twin.now / self._period)
        return self._ticks[k].inputs if k < len(self._ticks) else None

    def own(self) -> State | None:
        """See `HostLink`."""
        return self._link.own() if self._then is None else self._then.own

    def neighbours(self) -> dict[str, State]:
        """See `HostLink`."""
        return self._link.neighbours() if self._then is None else self._then.neighbours

    def messages(self) -> dict[str, LawMessage]:
        """See `HostLink`."""
        return self._link.messages() if self._then is None else self._then.messages
