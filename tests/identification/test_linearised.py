"""Windows reduced in blocks equal those taken one by one; a CSV reads alike by either reader."""

import numpy as np

from testbed.identification import csv_log
from testbed.identification.estimate import SCALES, linearise
from testbed.identification.model import VehicleModel
from testbed.identification.windows import first_guess, flown_with_slopes, pushed, tiled


def test_the_sums_are_those_of_each_window_by_itself(flight, floater):
    log = flight[1]
    whole = log.whole.copy()
    whole[300:330] = False  # windows of several lengths
    windows = tiled(log._replace(whole=whole), 0.8)  # more than one block
    model = VehicleModel(floater, valves=True)
    free, p = np.arange(len(model.names)), model.prior
    x0 = first_guess(windows, np.isfinite(windows.marks))
    found = linearise(model, p, free, [windows], [x0], SCALES)
    flown, by_state = flown_with_slopes(pushed(model, p, windows), windows, x0)
    assert len(found.power) == len(windows.rows) > 64
    for w, rows in enumerate(windows.rows):
        n = len(rows)
        error = ((windows.seen[w, :n] - flown[w, :n]) / SCALES).ravel()
        by_x = (by_state[w, :n] / SCALES[:, None]).reshape(-1, 6)
        start, *_ = np.linalg.lstsq(by_x, error, rcond=None)
        left = error - by_x @ start
        np.testing.assert_allclose(found.start[w], start, rtol=1e-9, atol=1e-12)
        np.testing.assert_allclose(found.power[w], left @ left, rtol=1e-9)
        assert found.size[w] == 3 * n
    assert len(found.error) == sum(map(len, windows.rows))


def test_plain_numbers_are_read_as_by_the_careful_reader(tmp_path, monkeypatch):
    numbers = np.random.default_rng(0).standard_normal((50, 3))
    for mark, point in ((",", "."), (";", ","), ("\t", ".")):
        path = tmp_path / "log.csv"
        rows = [mark.join(repr(float(x)).replace(".", point) for x in row) for row in numbers]
        path.write_text("\n".join(["# note", mark.join("abc"), *rows]))
        quick = csv_log._plain(path, {"a", "c"})
        with monkeypatch.context() as only:
            only.setattr(csv_log, "_plain", lambda *args: None)
            careful = csv_log.read_csv(path, {"a", "c"}, {})
        for name in "ac":
            np.testing.assert_array_equal(quick[name], careful[name])
    path.write_text("a,b,c\n1,2,3\n4,,6\n")
    assert csv_log._plain(path, {"a", "b"}) is None
