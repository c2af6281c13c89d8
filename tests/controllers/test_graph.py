"""The proximity graph: what makes a formation impossible, and what an edge remembers."""

import msgspec
import numpy as np
import pytest

from controllers.graph import (
    FormationParams,
    edge_after,
    formation,
    laplacian,
    pinned,
    proximity,
    smallest_eigenvalue,
    unreached,
)

NAMES = ("a", "b", "c")
CHAIN = {"a-b": 30.0, "b-c": 30.0, "a-c": 50.0}  # xue2022


def chain(**changes):
    given = {"range": 40.0, "safe": 10.0, "distances": CHAIN, "far_margin": 4.0, "near_margin": 4.0}
    return FormationParams(**given | changes)


def test_edges_of_the_start_are_the_pairs_that_belong_inside_the_range():
    shape = formation(chain(), NAMES)
    assert (shape.first[:3, :3] == [[0, 1, 0], [1, 0, 1], [0, 1, 0]]).all()
    assert shape.desired[0, 2] == shape.desired[2, 0] == 50.0
    assert (shape.near, shape.far, shape.join) == (14.0, 36.0, 36.0)


def test_the_leader_is_the_last():
    led = {"a-b": 30.0, "b-c": 30.0, "a-c": 50.0, "c-leader": 30.0, "a-leader": 90.0}
    shape = formation(chain(distances=led), NAMES, led=True)
    assert shape.first[2, 3] == 1.0
    assert shape.first[0, 3] == 0.0
    assert shape.desired[0, 3] == 90.0


def test_names_may_have_hyphens():
    names = ("sat-1", "sat-2")
    shape = formation(chain(distances={"sat-1-sat-2": 20.0}), names)
    assert shape.desired[0, 1] == 20.0


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"distances": CHAIN | {"a-d": 20.0}}, 'pair "a-b" of a, b, c, found "a-d"'),
        ({"distances": CHAIN | {"a-leader": 20.0}}, 'found "a-leader"'),
        ({"distances": CHAIN | {"b-a": 20.0}}, '"b-a" is given twice'),
        ({"distances": CHAIN | {"a-a": 20.0}}, "two different names"),
        ({"distances": {"a-b": 30.0, "b-c": 30.0}}, 'no distance for "a-c"'),
        ({"distances": CHAIN | {"a-b": 14.0}}, "near_margin = 14 m, found 14 m"),
        ({"edges": ("a-b", "a-c")}, r'edge "a-c" cannot reach .* = 36 m, found 50 m'),
        ({"edges": ("a-b",)}, "not connected: no path of edges leads from a to c"),
        ({"distances": CHAIN | {"a-b": 36.0}}, "leads from a to b, c"),
    ],
)
def test_a_formation_that_cannot_be_is_refused(changes, says):
    with pytest.raises(ValueError, match=says):
        formation(chain(**changes), NAMES)


def test_a_follower_must_hear_the_leader():
    with pytest.raises(ValueError, match="from leader to a, b, c"):
        formation(chain(), NAMES, led=True)


def test_no_vehicle_is_called_leader():
    with pytest.raises(ValueError, match="rename it"):
        formation(chain(), ("a", "leader"))


def test_ranges_that_leave_nothing_are_refused_where_they_are_written():
    text = b'{"range": 10.0, "safe": 9.0, "distances": {}}'
    with pytest.raises(msgspec.ValidationError, match="found 10 m and 9 m"):
        msgspec.json.decode(text, type=FormationParams)


# Memory


@pytest.mark.parametrize(
    ("edge", "gap", "after"),
    [
        (1.0, 39.9, 1.0),  # beyond the far margin: literal Eq. (2) would drop it here
        (1.0, 40.0, 0.0),  # out of hearing
        (0.0, 39.9, 0.0),  # hysteresis
        (0.0, 35.9, 1.0),
        (1.0, 5.0, 1.0),  # literal Eq. (2) would stop repelling
        (0.0, 5.0, 1.0),
    ],
)
def test_an_edge_is_kept_to_the_range_and_added_below_the_join(edge, gap, after):
    assert edge_after(formation(chain(), NAMES), edge, 0, 1, gap) == after


def test_a_pair_without_a_distance_never_interacts():
    assert edge_after(formation(chain(), NAMES), 0.0, 0, 3, 20.0) == 0.0


# Algebra


def test_laplacian_of_a_chain():
    adjacency = proximity(np.array([[0.0, 0.0], [1.0, 0.0], [2.0, 0.0]]), 1.5)
    assert (laplacian(adjacency) == [[1, -1, 0], [-1, 2, -1], [0, -1, 1]]).all()


def test_smallest_eigenvalue_of_the_chain_behind_a_leader():
    # path 1-2-3-leader: eigenvalues 2 - 2 cos((2 k - 1) pi / 7)
    led = {"a-b": 40.0, "b-c": 40.0, "a-c": 80.0, "c-leader": 40.0}
    shape = formation(FormationParams(range=50.0, safe=10.0, distances=led), NAMES, led=True)
    expected = 2.0 - 2.0 * np.cos(np.pi / 7.0)
    assert smallest_eigenvalue(pinned(shape.first)) == pytest.approx(expected)
    assert expected == pytest.approx(0.19806, abs=1e-5)


@pytest.mark.parametrize("seed", range(20))
def test_connected_is_what_the_second_eigenvalue_says(seed):
    rng = np.random.default_rng(seed)
    adjacency = proximity(rng.uniform(0.0, 10.0, (8, 2)), 4.0)
    second = np.linalg.eigvalsh(laplacian(adjacency))[1]
    assert (unreached(adjacency) == []) == (second > 1e-9)
