"""Train a small network to fly like the shipped `pd` law, and write it as policy.onnx.

    python examples/learning/train_policy.py [FILE]      # ten seconds
    testbed run configs/scenarios/step.toml \
        controller='{type="onnx", file="examples/learning/policy.onnx"}'

This is behaviour cloning and no more: the teacher is controllers/pd.py, and no flight is used. The
network has no biases, so it asks for no force at the goal, and mirrored errors get mirrored forces.
"""

import sys
from itertools import pairwise
from pathlib import Path

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

import testbed
from controllers.catalogue import make_law
from controllers.onnx_policy import observation
from controllers.pd import PdParams
from testbed.core.law import Body, Discs, Goal, World, silent
from testbed.flight.allocation import weakest_force

STEP = Path(__file__).parents[2] / "configs/scenarios/step.toml"
HIDDEN, SAMPLES, STEPS, BATCH, RATE = 32, 40_000, 12_000, 512, 3e-3
LARGEST = np.repeat([2.0, 0.15, 0.02, 0.02], 2)  # of each input: m, m/s, m/s^2, m/s^2
SCALE = np.repeat([0.5, 0.1, 0.02, 0.02], 2)  # inputs are divided by these
NOTHING = Discs(np.zeros((0, 2)), np.zeros((0, 2)), np.zeros(0))


def lessons(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Situations, small ones as often as large ones, and the teacher's share of the force."""
    step = testbed.load(STEP)
    vehicle = step.vehicles["sat1"].model
    most = step.guidance.force_share * weakest_force(vehicle)
    teacher, zero = make_law(PdParams(bandwidth=0.3)), np.zeros(2)
    size = LARGEST * 10.0 ** rng.uniform(-4.0, 0.0, (SAMPLES, 4)).repeat(2, axis=1)
    inputs, shares = [], []
    for off in size * rng.uniform(-1.0, 1.0, (SAMPLES, 8)):
        own = Body(-off[:2], -off[2:4], vehicle.mass, off[6:], zero, most)
        goal = Goal(zero, zero, off[4:6], zero)
        force, _ = teacher.rate(np.zeros(0), own, silent(NOTHING), World(goal, NOTHING), 0.0)
        inputs.append(observation(own, goal))
        shares.append(force / most)
    return np.array(inputs, float), np.array(shares)


def train(rng: np.random.Generator) -> list[np.ndarray]:
    """Weights of the three layers, by Adam on the relative error."""
    x, wanted = lessons(rng)
    x /= SCALE
    sizes = (8, HIDDEN, HIDDEN, 2)
    weights = [rng.normal(0.0, n**-0.5, (n, m)) for n, m in pairwise(sizes)]
    mean, square = ([np.zeros_like(w) for w in weights] for _ in range(2))
    for k in range(1, STEPS + 1):
        pick = rng.integers(0, SAMPLES, BATCH)
        one = np.tanh(x[pick] @ weights[0])
        two = np.tanh(one @ weights[1])
        size = np.linalg.norm(wanted[pick], axis=1, keepdims=True) + 0.01
        back = (two @ weights[2] - wanted[pick]) / size**2 / BATCH
        at_two = back @ weights[2].T * (1.0 - two**2)
        at_one = at_two @ weights[1].T * (1.0 - one**2)
        slopes = (x[pick].T @ at_one, one.T @ at_two, two.T @ back)
        rate = RATE * 0.5 * (1.0 + np.cos(np.pi * k / STEPS))
        for w, m, s, slope in zip(weights, mean, square, slopes, strict=True):
            m += 0.1 * (slope - m)
            s += 0.001 * (slope**2 - s)
            w -= rate * (m / (1.0 - 0.9**k)) / (np.sqrt(s / (1.0 - 0.999**k)) + 1e-9)
    off = np.tanh(np.tanh(x @ weights[0]) @ weights[1]) @ weights[2] - wanted
    print(f"mean error {np.abs(off).mean():.4f} of the largest force")
    weights[0] /= SCALE[:, None]
    return weights


def write(weights: list[np.ndarray], file: Path) -> None:
    """The network in the layout of controllers/onnx_policy.py."""
    nodes, now = [], "observation"
    for k in range(3):
        after = "action" if k == 2 else f"layer{k}"
        nodes.append(helper.make_node("MatMul", [now, f"w{k}"], [f"sum{k}" if k < 2 else after]))
        if k < 2:
            nodes.append(helper.make_node("Tanh", [f"sum{k}"], [after]))
        now = after
    graph = helper.make_graph(
        nodes, "pd_clone",
        [helper.make_tensor_value_info("observation", TensorProto.FLOAT, [1, 8])],
        [helper.make_tensor_value_info("action", TensorProto.FLOAT, [1, 2])],
        [numpy_helper.from_array(w.astype(np.float32), f"w{k}") for k, w in enumerate(weights)],
    )  # fmt: skip
    model = helper.make_model(graph, ir_version=8, opset_imports=[helper.make_opsetid("", 17)])
    onnx.checker.check_model(model)
    file.write_bytes(model.SerializeToString())
    print(f"{file}: {file.stat().st_size} bytes")


if __name__ == "__main__":
    place = Path(sys.argv[1] if len(sys.argv) > 1 else Path(__file__).with_name("policy.onnx"))
    write(train(np.random.default_rng(0)), place)
