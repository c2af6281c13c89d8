"""The tilt map: nodes where the file says, straight lines in between."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy.interpolate import RegularGridInterpolator

from sim_twin.ground import lay, tilt_at

UNIFORM = (0.0017, -0.0010)


def draw_map(rows, columns):
    grid = np.random.default_rng(9).uniform(-0.01, 0.01, (rows, columns, 2))
    return [[tuple(node) for node in row] for row in grid.tolist()]


def test_a_table_without_a_map_is_a_plane(make_table):
    ground = lay(make_table(tilt={"uniform": UNIFORM}))
    assert tilt_at(ground, 1.0, -2.0) == UNIFORM


@settings(deadline=None, max_examples=100)
@given(st.integers(2, 5), st.integers(2, 5), st.floats(-2.0, 2.0), st.floats(-1.5, 1.5))
def test_the_map_is_bilinear(make_table, rows, columns, x, y):
    nodes = draw_map(rows, columns)
    ground = lay(make_table(size=(4.0, 3.0), tilt={"uniform": UNIFORM, "map": nodes}))
    grid = np.linspace(-1.5, 1.5, rows), np.linspace(-2.0, 2.0, columns)
    wanted = RegularGridInterpolator(grid, np.array(nodes))([(y, x)])[0] + UNIFORM
    assert tilt_at(ground, x, y) == pytest.approx(wanted, abs=1e-15)


def test_beyond_the_edge_the_map_goes_on_as_it_ended(make_table):
    ground = lay(make_table(size=(4.0, 3.0), tilt={"map": draw_map(3, 3)}))
    assert tilt_at(ground, 9.0, 0.4) == tilt_at(ground, 2.0, 0.4)
    assert tilt_at(ground, -9.0, -9.0) == tilt_at(ground, -2.0, -1.5)


@pytest.mark.parametrize(("rows", "columns"), [(1, 1), (1, 3), (3, 1)])
def test_a_map_of_one_row_or_column_is_constant_across(make_table, rows, columns):
    nodes = draw_map(rows, columns)
    ground = lay(make_table(tilt={"map": nodes}))
    corners = [(x, y) for y in (-3.0, 3.0) for x in (-3.0, 3.0)]
    seen = np.array([tilt_at(ground, *corner) for corner in corners])
    assert_allclose(seen, [nodes[j][i] for j in (0, -1) for i in (0, -1)], atol=1e-15)
