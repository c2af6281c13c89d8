"""All constants of a vehicle's flight chain, as compiled code takes them."""

from typing import NamedTuple

from msgspec import Struct, field

from testbed.core.table import Table
from testbed.core.vehicle import Positive, Vehicle
from testbed.flight import (
    allocation,
    barrier,
    detectors,
    estimator,
    fault_monitor,
    fired,
    gate,
    jet_faults,
    online,
    plan,
    reconfiguration,
    safety,
    tracker,
)
from testbed.flight.allocation import AllocatorParams, Array, weakest_force
from testbed.flight.barrier import Barrier, BarrierParams
from testbed.flight.ending import EndingParams
from testbed.flight.estimator import EstimatorParams
from testbed.flight.faults import FaultTable
from testbed.flight.gate import Fence, GateParams
from testbed.flight.modulation import ModulatorParams, SigmaDeltaParams
from testbed.flight.online import OnlineParams
from testbed.flight.tracker import TrackerParams

SPARE_FORCE = 0.95  # of the weakest direction: margin for droop and weak jets


class FlightParams(Struct, frozen=True, forbid_unknown_fields=True):
    """Parameters of the chain on board."""

    jet_period_s: Positive = 0.1
    modulator: ModulatorParams = field(default_factory=SigmaDeltaParams)
    estimator: EstimatorParams = field(default_factory=EstimatorParams)
    tracker: TrackerParams = field(default_factory=TrackerParams)
    allocator: AllocatorParams = field(default_factory=AllocatorParams)
    online: OnlineParams = field(default_factory=OnlineParams)
    gate: GateParams = field(default_factory=GateParams)
    barrier: BarrierParams = field(default_factory=BarrierParams)
    ending: EndingParams = field(default_factory=EndingParams)


class Parameters(NamedTuple):
    """Constants of a vehicle's chain, stage by stage."""

    model: fired.Model
    filter: estimator.Filter
    online: online.Online
    command_delay: float  # from issuing a plan to its start on the board [s]
    gains: tracker.Gains
    filters: bool  # the safety filter is on
    limits: barrier.Limits
    obstacles: Array  # rows as in `barrier.filtered`
    sensors: detectors.Sensors
    jets_known: jet_faults.Known
    rows: fault_monitor.Rows
    brakes: safety.Brakes
    whole: reconfiguration.Whole
    gate: gate.Limits
    jets: allocation.Jets
    planner: plan.Planner


def stopping_force(vehicle: Vehicle) -> float:
    """Force of a vehicle's jets that a stop may use in any direction [N]."""
    return SPARE_FORCE * weakest_force(vehicle)


def make_parameters(
    flight: FlightParams, vehicle: Vehicle, table: Table, faults: FaultTable, fence: Fence,
    safe: Barrier | None,
) -> Parameters:  # fmt: skip
    """The constants of a vehicle on a table; `safe` is its safety filter, None: switched off."""
    period, end = flight.jet_period_s, flight.ending
    jets = allocation.jets_of(flight.allocator, vehicle)
    known = jet_faults.known_of(vehicle, period, flight.estimator, table)
    return Parameters(
        model=fired.model_of(vehicle),
        filter=estimator.filter_of(flight.estimator, vehicle, table.mocap),
        online=online.online_of(flight.online, vehicle),
        command_delay=vehicle.command_delay_s,
        gains=tracker.gains_of(flight.tracker, vehicle, period),
        filters=safe is not None,
        limits=barrier.UNLIMITED if safe is None else safe.limits,
        obstacles=barrier.discs_of([]) if safe is None else safe.obstacles,
        # cameras without noise may repeat a pose exactly, for a vehicle at rest
        sensors=detectors.Sensors(
            vehicle.air.set_pressure,
            vehicle.air.tank_pressure,
            table.mocap.noise > 0.0,
            table.mocap.frame_s,
            max(1e-6, stopping_force(vehicle) / vehicle.mass),
        ),
        jets_known=known,
        rows=fault_monitor.rows_of(faults),
        brakes=safety.Brakes(
            stopping_force(vehicle) / vehicle.mass, end.brake_s, end.margin, end.settle_s
        ),
        whole=reconfiguration.whole_of(jets.effect, vehicle.mass * known.slope),
        gate=gate.limits_of(flight.gate, fence),
        jets=jets,
        planner=plan.planner_of(flight.modulator, vehicle, period),
    )
