"""A policy in an ONNX file as a law, for instance a trained neural network.

    [controller]
    type = "onnx"
    file = "policy.onnx"      # relative to this file

The model is called once per jet period and its force is held. It has one input and one output, both
float32 with one row (or a free first axis):

    input   (1, 4 d)  goal - position [m], goal - velocity [m/s], acceleration of the goal [m/s^2],
                      own.disturbance [m/s^2]; in W, d numbers each (d = 2 on the table)
    output  (1, d)    force in W as a share of own.max_force; longer than 1 is shortened to 1

A policy sees neither obstacles nor other vehicles: the safety filter does. The heading is held by
the vehicle's own loop. `testbed/env` has the same input as its layout "goal".

The session has one thread and runs its nodes in order, and a model with random nodes is refused, so
equal inputs give equal bits.
"""

import hashlib
from pathlib import Path
from typing import Any

import numpy as np
from msgspec import Struct, field
from numpy.typing import NDArray

from controllers.law_file import LawError, UnusableLawError
from controllers.onnx_nodes import TRAINED, node_types
from controllers.sampled import Sampled
from controllers.scale import Scale
from testbed.core.extra import pip_install
from testbed.core.law import Body, Concern, Goal, Law, Neighbours, World, bounded
from testbed.core.vehicle import Positive

Array = NDArray[np.float64]

RANDOM = (
    "Bernoulli", "Multinomial", "RandomNormal", "RandomNormalLike", "RandomUniform",
    "RandomUniformLike",
)  # fmt: skip


class OnnxParams(Struct, frozen=True, forbid_unknown_fields=True, tag="onnx"):
    """The file of the policy."""

    file: str
    sha256: str | None = None  # of the file; null: any content
    period: Positive = 0.1  # hold time of a force if the caller does not give one [s]
    scale: Scale = field(default_factory=Scale)


def observation(own: Body, goal: Goal) -> NDArray[np.float32]:
    """The input of a policy, shape (4 d,)."""
    parts = (goal.p - own.p, goal.v - own.v, goal.a, own.disturbance)
    return np.concatenate(parts).astype(np.float32)


def content_of(file: str) -> bytes:
    """The bytes of a policy's file.

    Raises:
        UnusableLawError: it cannot be read.
    """
    try:
        return Path(file).read_bytes()
    except (OSError, ValueError) as error:
        reason = error.strerror if isinstance(error, OSError) else str(error)
        raise UnusableLawError("file", "the path of an ONNX file", f"{file}: {reason}") from None


class OnnxPolicy:
    """A policy; it has no state."""

    def __init__(self, params: OnnxParams, d: int) -> None:
        content, name = content_of(params.file), Path(params.file).name
        digest = hashlib.sha256(content).hexdigest()
        if params.sha256 not in (None, digest):
            expected = f"{params.sha256} (remove the key to accept any content)"
            raise UnusableLawError("sha256", expected, f"{digest}: {name} is another file")
        self._session = _session(content, name)
        _check_nodes(content, name)
        self._input = _only(self._session.get_inputs(), "input", 4 * d, name)
        self._output = _only(self._session.get_outputs(), "output", d, name)
        self._d, self._name = d, name

    def initial(self, own: Body, neighbours: Neighbours, world: World) -> Array:
        """See `Law`."""
        return np.zeros(0)

    def decide(
        self, law_state: Array, own: Body, neighbours: Neighbours, world: World, duration: float
    ) -> tuple[Array, Array]:
        """See `Decider`."""
        share = self.share(observation(own, world.goal))
        return bounded(own.max_force * share, own.max_force), law_state

    def share(self, seen: NDArray[np.float32]) -> Array:
        """The model's output (d,) for an input (4 d,).

        Raises:
            LawError: the model fails, or its output has another shape.
        """
        try:
            (output,) = self._session.run([self._output], {self._input: seen[None]})
        except Exception as error:  # see `_session`
            raise LawError(f"{self._name}: {str(error).splitlines()[0]}") from None
        if output.shape != (1, self._d):
            shapes = f"expected an output of shape [1, {self._d}], found {list(output.shape)}"
            raise LawError(f"{self._name}: {shapes}")
        return output[0].astype(np.float64)

    def concerns(self, law_state: Array) -> list[Concern]:
        """See `Decider`."""
        return []


def _session(content: bytes, name: str) -> Any:
    try:
        import onnxruntime
    except ImportError:
        found = f"none: {pip_install('onnx')}"
        raise UnusableLawError("file", "an installed onnxruntime", found) from None
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.execution_mode = onnxruntime.ExecutionMode.ORT_SEQUENTIAL
    options.use_deterministic_compute = True
    options.log_severity_level = 4  # what is wrong is said below
    try:
        return onnxruntime.InferenceSession(content, options, providers=["CPUExecutionProvider"])
    except Exception as error:  # the library has a class for each kind, without a common base
        found = f"{name}: {str(error).splitlines()[0]}"
        raise UnusableLawError("file", "an ONNX model", found) from None


def _check_nodes(content: bytes, name: str) -> None:
    try:
        found = sorted(node_types(content) & {*RANDOM, TRAINED})
    except ValueError as error:  # onnxruntime reads another format, too
        raise UnusableLawError("file", "an ONNX model", f"{name}: {error}") from None
    if found:
        expected = "a model without random nodes: export the mean action, which a flight repeats"
        raise UnusableLawError("file", expected, f"{name}: {', '.join(found)}")


def _only(ports: list[Any], which: str, size: int, name: str) -> str:
    """The name of the model's only input or output, which has the right type and shape."""
    shapes = [f"{one.name}: {one.type} {one.shape}" for one in ports]
    if len(ports) == 1 and ports[0].type == "tensor(float)" and len(ports[0].shape) == 2:
        rows, columns = ports[0].shape
        if (rows == 1 or not isinstance(rows, int)) and columns == size:
            return str(ports[0].name)
    expected = f"one {which} of type tensor(float) and shape [1, {size}]"
    raise UnusableLawError("file", expected, f"{name}: {'; '.join(shapes) or 'none'}")


def try_policy(params: OnnxParams, d: int = 2) -> None:
    """Call a policy twice, so that errors show before a flight and not in it.

    Raises:
        UnusableLawError: the file is no policy of this layout.
        LawError: the policy fails.
    """
    policy, seen = OnnxPolicy(params, d), np.linspace(-1.0, 1.0, 4 * d, dtype=np.float32)
    first, again = policy.share(seen), policy.share(seen)
    name = Path(params.file).name
    if not np.isfinite(first).all():
        raise LawError(f"{name}: output is not finite, {first}, in a trial call before the flight")
    if first.tobytes() != again.tobytes():
        raise LawError(f"{name}: output is {first} and then {again} for the same input")


def onnx_policy(params: OnnxParams, d: int) -> Law:
    """The law for positions of shape (d,).

    Raises:
        UnusableLawError: the file is no policy of this layout.
    """
    return Sampled(OnnxPolicy(params, d), params.period)
