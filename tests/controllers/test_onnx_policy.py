"""A policy in an ONNX file as a law: its layout, its bits, and the shipped example."""

import os
import shutil
from pathlib import Path

import numpy as np
import pytest

import testbed
from controllers.catalogue import make_law
from controllers.law_file import UnusableLawError
from controllers.onnx_policy import OnnxParams, observation
from controllers.pd import PdParams
from testbed.config import ConfigError
from testbed.core.law import Body, Discs, Goal, World, silent

ROOT = Path(__file__).parents[2]
POLICY = ROOT / "examples/learning/policy.onnx"
STEP = ROOT / "configs/scenarios/step.toml"
NOTHING = Discs(np.zeros((0, 2)), np.zeros((0, 2)), np.zeros(0))
ZERO = np.zeros(2)

if os.environ.get("CI") == "true":  # there a missing tool is a failure
    import onnx
    import onnxruntime
else:
    onnxruntime = pytest.importorskip("onnxruntime", reason="the extra `onnx` is not installed")
    onnx = pytest.importorskip("onnx", reason="the extra `learn` is not installed")


@pytest.fixture
def write_policy(tmp_path):
    """Write a model: its input times the weights, or the sum of its inputs."""
    make, kind = onnx.helper, onnx.TensorProto.FLOAT

    def write(inputs, outputs, weights=None):
        ins = [make.make_tensor_value_info(f"in{k}", kind, one) for k, one in enumerate(inputs)]
        outs = [make.make_tensor_value_info("out", kind, one) for one in outputs]
        names = [one.name for one in ins]
        if weights is None:
            node, known = make.make_node("Sum", names, ["out"]), []
        else:
            node = make.make_node("MatMul", [*names, "w"], ["out"])
            known = [onnx.numpy_helper.from_array(weights, "w")]
        graph = make.make_graph([node], "policy", ins, outs, known)
        model = make.make_model(graph, ir_version=8, opset_imports=[make.make_opsetid("", 17)])
        (tmp_path / "policy.onnx").write_bytes(model.SerializeToString())
        return str(tmp_path / "policy.onnx")

    return write


def scene(p, v, a=ZERO, disturbance=ZERO):
    own = Body(np.array(p), np.array(v), 12.5, np.array(disturbance), ZERO, 0.7)
    return own, World(Goal(np.array([0.5, 0.0]), ZERO, np.array(a), ZERO), NOTHING)


def force(law, *where):
    own, world = scene(*where)
    return law.rate(np.zeros(0), own, silent(NOTHING), world, 0.0)[0]


def fly(*overrides, seed=0, log=None):
    law = f'controller={{type="onnx", file="{POLICY}"}}'
    return testbed.fly(testbed.load(STEP, law, *overrides, seed=seed), log=log)


def test_the_layout_of_the_input():
    own, world = scene([0.1, 0.2], [0.01, 0.02], [0.003, 0.004], [0.005, 0.006])
    wanted = [0.4, -0.2, -0.01, -0.02, 0.003, 0.004, 0.005, 0.006]
    assert observation(own, world.goal).dtype == np.float32
    np.testing.assert_allclose(observation(own, world.goal), wanted, rtol=1e-6)


def test_the_example_does_as_its_teacher():
    law, teacher = make_law(OnnxParams(str(POLICY))), make_law(PdParams(bandwidth=0.3))
    for where in (([0.2, 0.1], [0.02, 0.0]), ([0.499, 0.001], [0.0, 1e-4]), ([-1.0, 0.8], [0, 0])):
        np.testing.assert_allclose(force(law, *where), force(teacher, *where), atol=0.03)
    assert force(law, [0.5, 0.0], [0.0, 0.0]).tolist() == [0.0, 0.0]


def test_an_action_is_a_share_of_the_force_and_at_most_all_of_it(write_policy):
    weights = np.zeros((8, 2), np.float32)
    weights[0, 0] = weights[1, 1] = 1.0
    law = make_law(OnnxParams(write_policy([[None, 8]], [["rows", 2]], weights)))
    np.testing.assert_allclose(force(law, [0.2, 0.4], ZERO), [0.21, -0.28], rtol=1e-6)
    np.testing.assert_allclose(force(law, [-2.5, 4.0], ZERO), [0.42, -0.56], rtol=1e-6)


def test_the_example_is_small_and_meets_the_criteria_of_step(tmp_path):
    assert POLICY.stat().st_size < 100_000
    run = fly(log=tmp_path / "a")
    assert run.passed, run.criteria
    assert run.metrics.vehicles["sat1"].settle_s < 20.0
    assert testbed.replay(run).first_difference is None
    again = testbed.fly(testbed.load(run.folder / "config.toml"))  # with the copy in the folder
    assert np.array_equal(again["sat1"].true_pose, run["sat1"].true_pose)
    shutil.copyfile(__file__, run.folder / "policy.onnx")
    with pytest.raises(ConfigError, match="is another file"):
        testbed.load(run.folder / "config.toml")


def test_it_flies_on_board_in_wrench_mode():
    run = fly("guidance.mode=wrench", "deploy.law=vehicle", "duration_s=60")
    assert run.metrics.completed
    assert run.metrics.vehicles["sat1"].settle_s < 20.0


def test_a_wrong_file_is_refused(tmp_path):
    (tmp_path / "text.onnx").write_text("not a model")
    for name, expected in (("none.onnx", "the path of an ONNX file"), ("text.onnx", "ONNX model")):
        with pytest.raises(UnusableLawError, match=expected):
            make_law(OnnxParams(str(tmp_path / name)))
    with pytest.raises(ConfigError, match="the path of an ONNX file"):
        testbed.load("hold", 'controller={type="onnx", file="none.onnx"}')


@pytest.mark.parametrize(
    ("inputs", "outputs", "expected"),
    [
        ([[1, 9]], [[1, 9]], r"one input of type tensor\(float\) and shape \[1, 8\]"),
        ([[1, 8]], [[1, 8]], r"one output of type tensor\(float\) and shape \[1, 2\]"),
        ([[1, 8], [1, 8]], [[1, 8]], "one input"),
        ([[8]], [[8]], "one input"),
    ],
)
def test_a_policy_of_another_layout_is_refused(inputs, outputs, expected, write_policy):
    with pytest.raises(UnusableLawError, match=expected):
        make_law(OnnxParams(write_policy(inputs, outputs)))


def test_a_missing_library_is_named(monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "onnxruntime", None)
    with pytest.raises(UnusableLawError, match=r"install.*onnx"):
        make_law(OnnxParams(str(POLICY)))
