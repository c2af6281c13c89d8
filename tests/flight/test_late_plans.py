"""Pulses that a busy computer lost are not taken for jets that are weak or shut."""

from msgspec.structs import replace

from sim_twin.twin import TwinPoses, TwinThrusters, TwinVehicleLink
from testbed.config import find, load
from testbed.flight.detectors import SPOILT
from testbed.flight.loop import VehicleNode
from testbed.rig.observers import NullObserver
from testbed.rig.twin import make_twin

LATE_S = 1.1 * SPOILT * 0.1  # of a jet period of 0.1 s


class LosingThrusters:
    """Thrusters of the twin that lose the pulses of every so many plans, if it has any."""

    def __init__(self, thrusters, every):
        self._thrusters, self._every, self._plans = thrusters, every, 0
        self.lost, self.land, self.health = False, thrusters.land, thrusters.health

    def apply(self, command):
        self._plans += any(command.on_us)
        self.lost = any(command.on_us) and self._plans % self._every == 0
        if self.lost:
            shut = (0,) * len(command.on_us)
            command = replace(command, on_us=shut, offset_us=shut)
        self._thrusters.apply(command)


def fly(*words, told=True, every=6):
    """A flight whose computer loses plans, and says so at the next tick if it is `told`."""

    def node(twin, name, chain):
        thrusters = LosingThrusters(TwinThrusters(twin, name), every)

        def vitals():
            return replace(twin.vitals(name), late_s=LATE_S if told and thrusters.lost else 0.0)

        link = TwinVehicleLink(twin, name)
        return VehicleNode(name, chain, TwinPoses(twin, name), thrusters, link, vitals)

    rig = make_twin(load(find("hold"), ["duration_s=60", *words]), node)
    ending = rig.fly(NullObserver())
    return ending.fault, [one.named_s for one in rig.jets("sat1")]


def test_lost_pulses_name_no_jet_if_the_vehicle_is_told():
    fault, named = fly()
    assert fault is None
    assert named == [None] * 8


def test_they_would_name_one_otherwise():
    fault, named = fly(told=False)
    assert fault is not None or any(named)


def test_a_jet_that_is_shut_is_found_among_lost_pulses():
    _, named = fly('inject=[{kind="stick_closed",vehicle="sat1",at_s=5.0,jet=2}]', every=10)
    assert [k + 1 for k, at in enumerate(named) if at is not None] == [2]
