"""Each formation law through the flight chain's integrator, and its parameters through a file."""

import msgspec
import numpy as np
import pytest

from controllers.bounded_formation import BoundedFormationParams, bounded_formation
from controllers.bounded_leader import BoundedLeaderParams, bounded_leader
from controllers.bounded_leader_varying import BoundedLeaderVaryingParams, bounded_leader_varying
from controllers.collision_sliding import CollisionSlidingParams, collision_sliding
from controllers.connectivity_dynamic import ConnectivityDynamicParams, connectivity_dynamic
from controllers.connectivity_static import ConnectivityStaticParams, connectivity_static
from controllers.scale import Scale, Scaled
from testbed.core.law import Body, Discs, Goal, Neighbours, World

Params = (
    BoundedFormationParams
    | BoundedLeaderParams
    | BoundedLeaderVaryingParams
    | CollisionSlidingParams
    | ConnectivityDynamicParams
    | ConnectivityStaticParams
)
PROXY = {"spring": 12.0, "limit": 0.8, "weight": 0.2, "height": 0.3}
LAWS = {
    "bounded_formation": (bounded_formation, {"proxy": PROXY, "beta": 2.4}),
    "bounded_leader": (bounded_leader, {"proxy": PROXY, "alpha": 2.5, "beta": 1.0}),
    "bounded_leader_varying": (bounded_leader_varying, {"proxy": PROXY, "alpha": 0.1, "beta": 0.1}),
    "collision_sliding": (collision_sliding, {}),
    "connectivity_dynamic": (connectivity_dynamic, {"k_s": 1.5}),
    "connectivity_static": (connectivity_static, {}),
}


def read(name):
    make, given = LAWS[name]
    distances = {"a-b": 1.5} | ({"a-leader": 1.4} if "leader" in name else {})
    shape = {"range": 2.0, "safe": 0.5, "far_margin": 0.2, "near_margin": 0.2}
    tree = {"type": name, "formation": shape | {"distances": distances}} | given
    return make, msgspec.json.decode(msgspec.json.encode(tree), type=Params)


@pytest.mark.parametrize("scale", [Scale(), Scale(length=20.0, time=5.0)])
@pytest.mark.parametrize("name", LAWS)
def test_flies_ahead_remembers_its_edges_and_tells(name, scale):
    make, params = read(name)
    law = Scaled(make(params, ("a", "b"), 2), scale)
    still = np.zeros(2)
    own = Body(still, still, 15.0, still, still, 1.0, 0)
    others = Neighbours(
        np.array([[1.2, 0.0]]), np.zeros((1, 2)), np.ones(1), np.array([1]),
        np.zeros((1, law.message_size)), np.zeros(1),
    )  # fmt: skip
    if law.message_size == 4:
        others.message[0, 0] = 1.2 * scale.length
    obstacles = Discs(np.zeros((0, 2)), np.zeros((0, 2)), np.zeros(0))
    world = World(Goal(np.array([-1.4, 0.0]), still, still, still), obstacles)
    start = law.initial(own, others, world)

    ahead = law.propagate(start, own, others, world, 0.0, 0.1, 4)

    assert len(ahead.message) == law.message_size
    assert np.isfinite(ahead.law_state).all()
    assert np.linalg.norm(ahead.mean_force) <= 1.0 + 1e-12
    if name.startswith(("connectivity", "bounded")):
        # in the paper's units the pair is 24 m apart, out of a range of 2 m
        assert ahead.law_state[-2] == (1.0 if scale.length == 1.0 else 0.0)


def test_a_wrong_key_is_refused():
    with pytest.raises(msgspec.ValidationError, match="unknown field `k_q`"):
        msgspec.json.decode(
            b'{"type": "connectivity_dynamic", "k_q": 1.0}', type=ConnectivityDynamicParams
        )
