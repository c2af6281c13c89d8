import numba
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.distance import pdist

from controllers.repulsion import nearby_share, pairs, repulsion, rows, rows_on_all_cores
from controllers.repulsion_cells import cells, cells_on_all_cores, grid_of

WAYS = [pairs, rows, rows_on_all_cores, cells, cells_on_all_cores]
every_way = pytest.mark.parametrize("way", WAYS, ids=lambda way: way.py_func.__name__)


def force_by(way, stiffness, reach, x):
    force = np.full_like(x, 123.0)  # what was there before must not matter
    way(stiffness, reach, x, force)
    return force


def in_numpy(stiffness, reach, x):
    """Eq. (13) corrected, N^2."""
    force = np.zeros_like(x)
    for i in range(len(x)):
        offset = x[i] - x
        d = np.linalg.norm(offset, axis=1)
        near = (d > 0.0) & (d < reach)
        force[i] = (stiffness * (reach / d[near] - 1.0)) @ offset[near]
    return force


def scattered(count, d, seed=0):
    return np.random.default_rng(seed).uniform(-1.0, 1.0, (count, d))


def assert_same(found, wanted):
    assert np.abs(found - wanted).max() <= 1e-12 * np.abs(wanted).max()


@every_way
@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("reach", [1e-3, 0.1, 0.5, 5.0])
@pytest.mark.parametrize("count", [2, 65, 700])
def test_every_way_gives_the_plain_sum(way, d, reach, count):
    x = scattered(count, d)
    wanted = in_numpy(2.5, reach, x)
    assert np.abs(force_by(way, 2.5, reach, x) - wanted).max() <= 1e-12 * np.abs(wanted).max()


@every_way
@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("offset", [0.0, 7e6, -1e9])
def test_far_from_the_origin(way, d, offset):
    x = 100.0 * scattered(300, d) + offset
    assert_same(force_by(way, 1.0, 20.0, x), in_numpy(1.0, 20.0, x))


@every_way
def test_a_lattice_whose_partners_sit_on_the_edges_of_cells(way):
    side = np.arange(12) * 0.1
    x = np.stack(np.meshgrid(side, side, side), axis=-1).reshape(-1, 3)
    for reach in (0.1, 0.1 * (1 + 1e-15), 0.1 + 1e-9, 0.2, 0.30000000000000004):
        wanted = in_numpy(1.0, reach, x)
        limit = 1e-12 * max(1e-3, np.abs(wanted).max())
        assert np.abs(force_by(way, 1.0, reach, x) - wanted).max() <= limit


@every_way
@given(st.integers(0, 2**32 - 1), st.sampled_from([2, 3]), st.integers(1, 40), st.floats(1e-3, 1e3))
def test_clumps_of_any_size(way, seed, d, count, spread):
    rng = np.random.default_rng(seed)
    x = spread * rng.normal(size=(count, d)) + rng.integers(-3, 4, (count, d))
    wanted = in_numpy(1.0, 1.0, x)
    scale = np.abs(wanted).max()
    assert np.abs(force_by(way, 1.0, 1.0, x) - wanted).max() <= 1e-12 * scale


@every_way
@pytest.mark.parametrize("d", [2, 3])
def test_forces_cancel(way, d):
    force = force_by(way, 3.0, 0.4, scattered(900, d))
    assert np.abs(force.sum(axis=0)).max() <= 1e-13 * np.abs(force).sum()


def test_two_satellites_push_each_other_apart():
    force = repulsion([[0.0, 0.0], [0.6, 0.8]], stiffness=2.0, reach=1.5)
    # k_c (s - d) along the line between them, d = 1
    assert force[1] == pytest.approx([0.6, 0.8])
    assert force[0] == pytest.approx([-0.6, -0.8])


@pytest.mark.parametrize("d", [2, 3])
def test_force_is_the_descent_of_the_potential(d):
    x, reach, h = scattered(20, d), 0.8, 1e-5

    def potential(x):  # Eq. (12) corrected
        gap = pdist(x)
        return 0.5 * 1.7 * np.sum(np.where(gap < reach, (reach - gap) ** 2, 0.0))

    force = repulsion(x, 1.7, reach)
    for i, a in [(0, 0), (7, 1), (19, d - 1)]:
        step = np.zeros_like(x)
        step[i, a] = h
        slope = (potential(x + step) - potential(x - step)) / (2 * h)
        assert force[i, a] == pytest.approx(-slope, abs=1e-6)


@every_way
@pytest.mark.parametrize("d", [2, 3])
def test_satellites_at_the_same_place_do_not_push(way, d):
    x = np.repeat(scattered(30, d), 3, axis=0)
    force = force_by(way, 1.0, 0.5, x)
    assert_same(force, in_numpy(1.0, 0.5, x))
    assert_same(force[::3], force[1::3])
    assert force_by(way, 1.0, 0.5, np.ones((10, d))).tolist() == np.zeros((10, d)).tolist()


@every_way
@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_a_nan_position_gets_nan_and_pushes_no_other(way, d, value):
    x = scattered(100, d)
    x[17, d - 1] = value
    force = force_by(way, 1.0, 0.5, x)
    assert np.all(np.isnan(force[17]))
    others = np.delete(np.arange(100), 17)
    assert_same(force[others], in_numpy(1.0, 0.5, x[others]))


@every_way
@pytest.mark.parametrize("reach", [0.0, 1e-300, 1e300])
def test_extreme_reach(way, reach):
    x = scattered(50, 3)
    force = force_by(way, 1e-300, reach, x)
    assert np.all(np.isfinite(force))
    if reach < 1.0:
        assert force.tolist() == np.zeros((50, 3)).tolist()


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize(
    ("one", "all_cores"), [(rows, rows_on_all_cores), (cells, cells_on_all_cores)]
)
def test_threads_do_not_change_a_bit(one, all_cores, d):
    x = scattered(5000, d)
    wanted = force_by(one, 1.0, 0.2, x)
    for threads in range(1, numba.config.NUMBA_NUM_THREADS + 1):
        numba.set_num_threads(threads)
        try:
            found = force_by(all_cores, 1.0, 0.2, x)
        finally:
            numba.set_num_threads(numba.config.NUMBA_NUM_THREADS)
        assert found.tobytes() == wanted.tobytes()


@pytest.mark.parametrize(
    ("count", "reach"), [(100, 0.5), (1000, 0.05), (1000, 2.0), (3000, 2.0), (20_000, 0.02)]
)
def test_the_way_that_is_chosen_gives_the_same(count, reach):
    x = scattered(count, 2)
    assert_same(repulsion(x, 1.0, reach), force_by(cells, 1.0, reach, x))


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize(("apart", "scattered"), [(0.0, False), (1e5, True)])
def test_rows_of_cells_in_order_or_scattered_give_each_pair_once(d, apart, scattered):
    x = scattered_in_two(d, apart)
    assert (grid_of(x, 0.2)[3] > 0) == scattered
    for way in (cells, cells_on_all_cores):
        assert_same(force_by(way, 1.0, 0.2, x), in_numpy(1.0, 0.2, x))


def scattered_in_two(d, apart):
    x = scattered(2000, d)
    x[::2] += apart
    return x


def test_crowds_are_told_from_crowded_places():
    x = scattered(500, 2)
    assert nearby_share(x, 10.0) == 1.0
    assert nearby_share(x, 0.02) < 0.002
    assert nearby_share(np.r_[x, [[np.nan, np.inf]]], 0.02) < 0.002


def test_no_satellites_no_forces():
    assert repulsion(np.zeros((0, 3)), 1.0, 1.0).shape == (0, 3)
    assert repulsion([[1.0, 2.0]], 1.0, 1.0).tolist() == [[0.0, 0.0]]


@pytest.mark.parametrize(
    ("x", "stiffness", "reach", "message"),
    [
        (np.zeros((3, 4)), 1.0, 1.0, r"shape \(n, 2\) or \(n, 3\), found \(3, 4\)"),
        (np.zeros(3), 1.0, 1.0, r"found \(3,\)"),
        (np.zeros((3, 2)), 1.0, -1.0, "found reach = -1.0"),
        (np.zeros((3, 2)), 1.0, np.nan, "found reach = nan"),
        (np.zeros((3, 2)), np.inf, 1.0, "stiffness = inf"),
    ],
)
def test_nonsense_is_refused(x, stiffness, reach, message):
    with pytest.raises(ValueError, match=message):
        repulsion(x, stiffness, reach)
