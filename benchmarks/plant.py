"""Speed of the plant, and of MuJoCo at 1 kHz with the same scene in the same run.

    python benchmarks/plant.py [simulated seconds]

Three shipped vehicles on the shipped table; in each period of 0.1 s every vehicle fires three jets.
Both sides look for contacts, and their loops are compiled: the plant's through numba, MuJoCo's
through its own `rollout`. Beside them the whole closed loop, as zhang2023_table flies it: plant,
cameras, radio, estimator, law, safety, jets; in memory, and with its log written to disk. They take
turns and the fastest of some rounds counts, for the machine is never idle.
"""

import sys
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter

import msgspec
import mujoco
import numpy as np
from mujoco import rollout

from sim_twin.plant import Plant
from testbed.config import SHIPPED, find, load, read_toml
from testbed.core.table import Table
from testbed.core.types import Pose, ValveCommand
from testbed.core.vehicle import Vehicle
from testbed.rig.observers import NullObserver
from testbed.rig.twin import make_twin
from testbed.run.fly import fly_and_judge

PERIOD = 0.1  # [s]
STEP = 0.001  # MuJoCo's [s]
FRAMES = np.linspace(0.01, PERIOD, 10)  # of the cameras in a period [s]
STARTS = {"a": Pose(-1.5, 0.0, 0.0), "b": Pose(0.0, 1.0, 2.0), "c": Pose(1.5, -1.0, -2.0)}
ROUNDS = 10


def draw_plans(seconds: float) -> list[dict[str, ValveCommand]]:
    """A plan for each vehicle in each period."""
    rng, plans = np.random.default_rng(1), []
    for k in range(round(seconds / PERIOD)):
        plans.append({})
        for name in STARTS:
            on = np.zeros(8, dtype=int)
            on[rng.choice(8, 3, replace=False)] = 1000 * rng.integers(10, 80, 3)
            offset = (100_000 - on) // 2
            start = PERIOD * k
            plans[-1][name] = ValveCommand(
                k, start, start + PERIOD, tuple(on.tolist()), tuple(offset.tolist())
            )
    return plans


def controls(plans: list[dict[str, ValveCommand]]) -> np.ndarray:
    """Controls for MuJoCo: every jet open or closed in every step, shape (steps, jets)."""
    steps = np.arange(round(PERIOD / STEP)) * STEP * 1e6
    periods = []
    for plan in plans:
        on = np.concatenate([plan[name].on_us for name in STARTS])
        offset = np.concatenate([plan[name].offset_us for name in STARTS])
        periods.append((offset <= steps[:, None]) & (steps[:, None] < offset + on))
    return np.concatenate(periods).astype(float)


def scene(vehicle: Vehicle, table: Table) -> str:
    """Discs on slides and hinges, walls, and an actuator at each nozzle."""
    bodies, motors = [], []
    for name, pose in STARTS.items():
        sites = []
        for j, jet in enumerate(vehicle.jets):
            fx, fy = jet.thrust * np.array(jet.push)
            sites.append(f'<site name="{name}{j}" pos="{jet.position[0]} {jet.position[1]} 0"/>')
            motors.append(f'<general site="{name}{j}" gear="{fx} {fy} 0 0 0 0"/>')
        bodies.append(f"""
            <body pos="{pose.x} {pose.y} 0" euler="0 0 {np.degrees(pose.theta)}">
              <joint type="slide" axis="1 0 0"/>
              <joint type="slide" axis="0 1 0"/>
              <joint type="hinge" axis="0 0 1"/>
              <inertial pos="0 0 0" mass="{vehicle.mass}" diaginertia="1 1 {vehicle.inertia}"/>
              <geom type="cylinder" size="{vehicle.radius} 0.1" condim="1"/>
              {"".join(sites)}
            </body>""")
    walls = [
        f'<geom type="plane" size="9 9 1" pos="{x} {y} 0" zaxis="{-x} {-y} 0" condim="1"/>'
        for x, y in ((3, 0), (-3, 0), (0, 3), (0, -3))
    ]
    gx, gy = table.tilt.uniform
    return f"""
        <mujoco>
          <option timestep="{STEP}" gravity="{gx} {gy} 0"/>
          <worldbody>{"".join(walls + bodies)}</worldbody>
          <actuator>{"".join(motors)}</actuator>
        </mujoco>"""


def fastest(*make_rounds: Callable[[], Callable[[], object]]) -> list[float]:
    """Seconds of each one's fastest round, in turns; what a round needs is made off the clock.

    A round that gives a number has measured its own seconds.
    """
    took: list[list[float]] = [[] for _ in make_rounds]
    for _ in range(ROUNDS):
        for make_round, times in zip(make_rounds, took, strict=True):
            fly = make_round()
            begin = perf_counter()
            own = fly()
            times.append(own if isinstance(own, float) else perf_counter() - begin)
    return list(map(min, took))


def main(seconds: float) -> None:
    vehicle = msgspec.convert(read_toml(SHIPPED / "vehicles" / "generic_8jet.toml"), Vehicle)
    table = msgspec.convert(read_toml(SHIPPED / "tables" / "marble_6m.toml"), Table)
    plans = draw_plans(seconds)

    def plant_round() -> Callable[[], None]:
        plant = Plant(dict.fromkeys(STARTS, vehicle), STARTS, table, {}, seed=0)
        boards = plant.boards

        def fly() -> None:
            for k, plan in enumerate(plans):
                for name, command in plan.items():
                    boards[name].apply(command)
                plant.advance(PERIOD * (k + 1), PERIOD * k + FRAMES)

        return fly

    model = mujoco.MjModel.from_xml_string(scene(vehicle, table))
    control = controls(plans)

    def mujoco_round() -> Callable[[], None]:
        data = mujoco.MjData(model)
        state = np.zeros(mujoco.mj_stateSize(model, mujoco.mjtState.mjSTATE_FULLPHYSICS))
        mujoco.mj_getState(model, data, state, mujoco.mjtState.mjSTATE_FULLPHYSICS)
        return lambda: rollout.rollout(model, data, state, control)

    experiment = load(find("zhang2023_table"), [f"duration_s={seconds}"])

    def loop_round() -> Callable[[], object]:
        rig = make_twin(experiment)
        return lambda: rig.fly(NullObserver())

    def logged_round() -> Callable[[], float]:
        def fly() -> float:
            with TemporaryDirectory() as folder:
                return fly_and_judge(experiment, Path(folder)).wall_s

        return fly

    rounds = (plant_round, mujoco_round, loop_round, logged_round)
    for one in rounds:
        one()()  # compiles
    plant, other, loop, logged = fastest(*rounds)

    windows = len(STARTS) * len(plans)
    print(f"{len(STARTS)} vehicles, {seconds:g} simulated seconds, fastest of {ROUNDS} rounds")
    print(f"{'':24}{'us per vehicle and 0.1 s':>26}{'x real time':>14}")
    for what, took in (
        ("plant, exact pulses", plant), ("MuJoCo, 1 kHz", other), ("the whole closed loop", loop),
        ("with its log on disk", logged),
    ):  # fmt: skip
        print(f"{what:24}{1e6 * took / windows:26.2f}{seconds / took:14.0f}")
    print(
        f"times as fast as MuJoCo: plant {other / plant:.1f}, loop {other / loop:.2f},"
        f" with its log {other / logged:.2f}"
    )


if __name__ == "__main__":
    main(float(sys.argv[1]) if len(sys.argv) > 1 else 20.0)
