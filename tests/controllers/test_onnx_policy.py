"""A policy in an ONNX file as a law: its layout, its bits, and the shipped example."""

import os
import shutil
from pathlib import Path

import numpy as np
import pytest

import testbed
from controllers import onnx_policy
from controllers.catalogue import make_law
from controllers.law_file import LawError, UnusableLawError
from controllers.onnx_nodes import node_types
from controllers.onnx_policy import RANDOM, OnnxParams, observation
from controllers.pd import PdParams
from testbed.config import ConfigError
from testbed.core.law import Body, Discs, Goal, World, silent
from testbed.realtime.wall_clock import monotonic_ns, sleep_until_ns

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
    """Write a model: its input times the weights, or the sum of its inputs; or the nodes given."""
    make, kind = onnx.helper, onnx.TensorProto.FLOAT

    def write(inputs, outputs, weights=None, nodes=()):
        ins = [make.make_tensor_value_info(f"in{k}", kind, one) for k, one in enumerate(inputs)]
        outs = [make.make_tensor_value_info("out", kind, one) for one in outputs]
        names = [one.name for one in ins]
        if weights is None:
            node, known = make.make_node("Sum", names, ["out"]), []
        else:
            node = make.make_node("MatMul", [*names, "w"], ["out"])
            known = [onnx.numpy_helper.from_array(weights, "w")]
        graph = make.make_graph(nodes or [node], "policy", ins, outs, known)
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


ONE_ROW = [[1, 8]], [[1, 2]], np.ones((8, 2), np.float32)
ANY_ROWS = [["n", 8]], [["m", 2]], np.ones((8, 2), np.float32)


def nodes(*types, **attributes):
    """A chain of nodes after the product of input and weights; the last one makes the output."""
    make = onnx.helper.make_node
    names = ["product", *(f"after{k}" for k in range(len(types) - 1)), "out"]
    chain = [make(t, [names[k]], [names[k + 1]], **attributes) for k, t in enumerate(types)]
    return [make("MatMul", ["in0", "w"], ["product"]), *chain]


def in_a_branch(kind):
    """A node of this type in a subgraph."""
    make, tensor = onnx.helper, onnx.TensorProto
    out = make.make_tensor_value_info("chosen", tensor.FLOAT, None)
    noise = make.make_node(kind, [], ["chosen"], shape=[1, 2])
    still = make.make_node("Constant", [], ["chosen"], value_floats=[0.0, 0.0])
    yes, no = (make.make_graph([one], "branch", [], [out]) for one in (noise, still))
    true = make.make_tensor("true", tensor.BOOL, [], [True])
    return [
        make.make_node("Constant", [], ["choice"], value=true),
        make.make_node("If", ["choice"], ["out"], then_branch=yes, else_branch=no),
    ]


def refusal(policy):
    with pytest.raises(ConfigError) as error:
        testbed.load(STEP, f'controller={{type="onnx", file="{policy}"}}')
    return str(error.value)


def test_all_nodes_are_found(write_policy):
    assert node_types(POLICY.read_bytes()) == {one.op_type for one in onnx.load(POLICY).graph.node}
    found = node_types(Path(write_policy(*ONE_ROW, in_a_branch("RandomNormal"))).read_bytes())
    assert found == {"Constant", "If", "RandomNormal"}


def test_a_policy_with_random_nodes_is_refused(write_policy):
    random = write_policy(*ONE_ROW, nodes("Tanh", "RandomNormalLike"))
    assert "policy.onnx: RandomNormalLike" in refusal(random)
    assert "export the mean action" in refusal(random)
    assert "policy.onnx: RandomUniform" in refusal(
        write_policy(*ONE_ROW, in_a_branch("RandomUniform"))
    )


def test_dropout_in_training_mode_is_random(write_policy):
    make, tensor = onnx.helper, onnx.TensorProto
    rate = make.make_node("Constant", [], ["rate"], value_float=0.001)
    true = make.make_tensor("true", tensor.BOOL, [], [True])
    mode = make.make_node("Constant", [], ["mode"], value=true)
    product = make.make_node("MatMul", ["in0", "w"], ["product"])
    drop = make.make_node("Dropout", ["product", "rate", "mode"], ["out"], seed=1)
    policy = write_policy(*ONE_ROW, [rate, mode, product, drop])
    assert "policy.onnx: Dropout in training mode" in refusal(policy)
    still = Path(write_policy(*ONE_ROW, nodes("Dropout"))).read_bytes()
    assert node_types(still) == {"MatMul", "Dropout"}


def test_every_random_node_of_onnx_is_known():
    every = {one.name for one in onnx.defs.get_all_schemas() if not one.domain}
    assert {name for name in every if name.startswith("Random")} < set(RANDOM) <= every


def test_a_policy_that_says_no_numbers_is_refused_before_a_flight(write_policy):
    assert "output is not finite, [nan nan]" in refusal(
        write_policy(*ONE_ROW, nodes("Abs", "Neg", "Log"))
    )


def test_a_policy_with_two_rows_is_refused_before_a_flight(write_policy):
    make = onnx.helper.make_node
    twice = [*nodes("Neg")[:1], make("Concat", ["product", "product"], ["out"], axis=0)]
    policy = write_policy(*ANY_ROWS, twice)
    assert "expected an output of shape [1, 2], found [2, 2]" in refusal(policy)
    with pytest.raises(LawError, match="found \\[2, 2\\]"):
        force(make_law(OnnxParams(policy)), [0.2, 0.1], ZERO)


class Session:
    """The session of a policy, with other calls."""

    def __init__(self, session, run):
        self.get_inputs, self.get_outputs, self._session = (
            session.get_inputs, session.get_outputs, session,
        )  # fmt: skip
        self._run = run

    def run(self, *arguments):
        return self._run(self._session, *arguments)


@pytest.fixture
def patch_calls(monkeypatch):
    make = onnx_policy._session

    def patch(run):
        monkeypatch.setattr(onnx_policy, "_session", lambda *a: Session(make(*a), run))

    return patch


def test_a_policy_that_varies_is_refused_before_a_flight(patch_calls):
    noise = np.random.default_rng(0)
    patch_calls(lambda *_: [noise.normal(size=(1, 2)).astype(np.float32)])
    assert "for the same input" in refusal(POLICY)


def test_a_slow_policy_is_watched(patch_calls):
    def slow(session, *arguments):
        sleep_until_ns(monotonic_ns() + 250_000_000)  # 0.1 s are allowed
        return session.run(*arguments)

    experiment = testbed.load(
        STEP, f'controller={{type="onnx", file="{POLICY}"}}', "duration_s=1.2", "criteria={}"
    )
    patch_calls(slow)
    run = testbed.fly(experiment)
    assert "law policy.onnx takes 0.25 s per call, 2.5 times the 0.1 s" in run.fault
    assert "slow_law" in {one.name for one in run.metrics.warnings}


def test_a_policy_that_fails_in_flight_is_named(patch_calls):
    experiment = testbed.load(STEP, f'controller={{type="onnx", file="{POLICY}"}}')

    def fail(*_):
        raise RuntimeError("no such kernel\nand more")

    patch_calls(fail)
    assert "policy.onnx: no such kernel" in testbed.fly(experiment).fault


def test_a_missing_library_is_named(monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "onnxruntime", None)
    with pytest.raises(UnusableLawError, match=r"install.*onnx"):
        make_law(OnnxParams(str(POLICY)))
