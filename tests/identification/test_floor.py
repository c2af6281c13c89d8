"""A slope map is right also where the vehicle file is not, and its uncertainty is honest."""

import numpy as np
import pytest

from testbed.identification.floor import learn_floor


@pytest.fixture(scope="module")
def learned(flight, floater):
    reach = 2.2 * np.abs(flight[1].pose[:, :2]).max(axis=0)
    return learn_floor([flight[1]], floater, (float(reach[0]), float(reach[1])), 5)


def test_wrong_jets_in_the_file_make_no_slope(learned):
    told = learned.sigma.min(axis=2) < 0.5 * learned.sigma.max()
    z = (learned.slope / learned.sigma)[told]  # the table is level
    assert told.sum() >= 4
    assert np.sqrt(np.mean(z**2)) < 1.5
    assert np.median(np.abs(learned.slope[told])) < 1e-3


def test_the_vehicle_of_a_slope_map_has_its_own_jets(learned, flight):
    own = learned.model.fitted(learned.p)
    for jet, true in zip(own.jets, flight[0].jets, strict=True):
        assert jet.thrust == pytest.approx(true.thrust, rel=0.02)
