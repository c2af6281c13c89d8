"""NUMBA_DISABLE_JIT=1 steps through the twin in plain Python, with the same bits."""

import hashlib
import os
import subprocess
import sys
from pathlib import Path

from sim_twin.twin import Twin, TwinHostLink, TwinPoses, TwinThrusters, TwinVehicleLink
from testbed.config import find, load
from testbed.core.fault_injection import Injection
from testbed.core.types import Accel, Demand, Pose, State, Twist, ValveCommand

INJECTED = [
    Injection(kind="swap_bodies", vehicle="sat1", other="sat2", at_s=0.15, for_s=0.1),
    Injection(kind="lose_link", vehicle="sat2", at_s=0.0, value=0.5),
    Injection(kind="stick_open", vehicle="sat3", at_s=0.12, jet=2),
]


def flown():
    """A digest of all that a twin tells in three windows."""
    spoilt = ["table.mocap.dropout_rate=5.0", "table.link.loss=0.3", "table.link.burst_enter=0.3"]
    experiment = load(find("zhang2023_table"), spoilt)
    fleet = {name: setup.model for name, setup in experiment.vehicles.items()}
    starts = {name: Pose(*setup.start) for name, setup in experiment.vehicles.items()}
    twin = Twin(fleet, starts, experiment.table, {}, 3, listeners=list(fleet), injections=INJECTED)
    told = []
    for k in range(3):
        t = 0.1 * k
        twin.wait_until(t)
        for n, name in enumerate(twin.names):
            link, host = TwinVehicleLink(twin, name), TwinHostLink(twin, name)
            told.append((TwinPoses(twin, name).samples(), twin.health(name)))
            told.append((link.setpoint(), link.neighbours(), host.own(), host.neighbours()))
            on = tuple(10_000 * (j % 3 == (k + n) % 3) for j in range(8))
            TwinThrusters(twin, name).apply(ValveCommand(k, t, t + 0.1, on, (7_000,) * 8))
            x = float(n + k)
            still = Twist(0.0, 0.0, 0.0), Accel(0.0, 0.0, 0.0)
            link.publish(State(t, Pose(x, 0.0, 0.0), *still, 0.0, k))
            host.publish(Demand(t, x, 0.0, 0.0, 0.0, 0.0, t + 1.0))
    return hashlib.blake2b(repr((told, twin.plant.x.tolist())).encode()).hexdigest()


def test_without_the_compiler_every_bit_is_the_same():
    words = [sys.executable, "-W", "error", __file__]
    path = os.pathsep.join([str(Path(__file__).parents[2]), os.environ.get("PYTHONPATH", "")])
    plain = os.environ | {"NUMBA_DISABLE_JIT": "1", "PYTHONPATH": path}
    said = subprocess.run(words, env=plain, capture_output=True, text=True, check=True).stdout
    assert said.strip() == flown()


if __name__ == "__main__":
    sys.stdout.write(flown())
