"""`testbed.fly_many`: many experiments at once."""

import math
import os
import sys
from concurrent.futures import ThreadPoolExecutor

import pytest

import testbed
from testbed.campaign.process_pool import LostRunError, Worker
from testbed.campaign.worker import Order

SPOILT = {
    "killed": "os.kill(os.getpid(), 9)",
    "raises": "1 / 0",
    "nan": "return own.p * math.nan",
    "hangs": "while True: pass",
}
LIMIT_S = 0.2


@pytest.fixture(scope="module")
def hold():
    return testbed.load("hold").with_(duration_s=2)


def spoilt(hold, folder, name):
    law = folder / f"{name}.py"
    law.write_text(
        "import math, os\nclass Own:\n    step_s = 0.05\n"
        "    def force(self, own, neighbours, world, t):\n"
        f"        if t > 1.0:\n            {SPOILT[name]}\n        return 0.0 * own.p\n"
    )
    own = {"type": "python", "law": f"{law}:Own"}
    return hold.with_({"controller": own, "deploy.law_limit_s": LIMIT_S})


def test_a_bad_law_spoils_its_own_run_only(hold, tmp_path):
    bad = [spoilt(hold, tmp_path, name) for name in SPOILT]
    good = [hold.with_(seed=seed) for seed in range(len(bad))]
    mixed = [one for pair in zip(bad, good, strict=True) for one in pair]
    table = testbed.fly_many(mixed, jobs=2)
    outcomes, reasons = table["outcome"][::2].tolist(), table["reason"][::2].tolist()
    assert outcomes == ["lost", "fault", "fault", "fault"]
    assert "SIGKILL" in reasons[0]
    assert "ZeroDivisionError" in reasons[1]
    assert "nan.py:4, in force at" in reasons[2]
    assert f"hangs.py:6, in force: did not return within {LIMIT_S:g} s" in reasons[3]
    assert not set(table["outcome"][1::2].tolist()) & {"lost", "error"}
    alone = [testbed.fly(one).metrics.vehicles["sat1"].impulse_ns for one in good]
    assert table["impulse_ns"][1::2].tolist() == alone


def in_a_thread(call):
    with ThreadPoolExecutor(1) as threads:
        return threads.submit(call).result(60.0)


@pytest.mark.parametrize("where", [lambda call: call(), in_a_thread], ids=["main", "thread"])
def test_a_law_that_hangs_in_this_process_ends_its_own_run_only(hold, tmp_path, where):
    hanging = spoilt(hold, tmp_path, "hangs")
    other = {"type": "python", "law": spoilt(hold, tmp_path, "nan").controller.law}
    laws = [{"type": "python", "law": hanging.controller.law}, other]
    table = where(lambda: testbed.sweep(hanging, over={"controller": laws}))
    assert table["outcome"].tolist() == ["fault", "fault"]
    assert "hangs.py:6, in force: did not return" in table["reason"][0]
    assert "nan.py:4, in force at" in table["reason"][1]
    assert "found array([nan, nan])" in table["reason"][1]
    fault = where(lambda: testbed.fly(hanging).fault)
    assert "hangs.py:6, in force: did not return" in fault


def test_a_flight_is_the_same_alone_and_among_64(hold):
    many = [hold.with_(seed=seed) for seed in range(64)]
    table = testbed.fly_many(many, jobs=2)
    for k in (0, 31, 63):
        alone = testbed.fly_many([many[k]], jobs=1)
        for name in table:
            assert repr(table[name][k]) == repr(alone[name][0]), (k, name)
    assert len(set(table["impulse_ns"].tolist())) > 32  # seeds matter


def test_different_experiments_share_a_table(hold):
    three = testbed.load("zhang2023_table").with_(duration_s=1)
    table = testbed.fly_many([hold, three, hold.with_(seed=5)], jobs=2)
    assert table["experiment"].tolist() == ["hold", "zhang2023_table", "hold"]
    assert table["seed"].tolist() == [hold.seed, three.seed, 5]
    assert math.isnan(table["min_vehicle_distance_m"][0])
    assert table["min_vehicle_distance_m"][1] > 0.0
    assert testbed.fly_many([]).rows == 0


@pytest.mark.parametrize(
    ("does", "said"),
    [("import time; time.sleep(1000)", "no result after 0.2 s"), ("exit(3)", "with code 3")],
)
def test_a_worker_that_hangs_or_ends_loses_its_run(does, said):
    worker = Worker([sys.executable, "-c", does])
    with pytest.raises(LostRunError, match=said):
        worker.fly(Order(0, "name"), 0.2 if "after" in said else 60.0)
    worker.stop()


def test_ctrl_c_in_a_terminal_does_not_reach_a_worker():
    does = f"import os; assert os.getsid(0) != {os.getsid(0)}; exit(4)"
    worker = Worker([sys.executable, "-c", does])
    with pytest.raises(LostRunError, match="with code 4"):
        worker.fly(Order(0, "name"), 60.0)
    worker.stop()


def test_a_worker_that_was_ended_starts_no_process():
    worker = Worker([sys.executable, "-c", "import time; time.sleep(1000)"])
    worker.end()
    with pytest.raises(LostRunError, match="interrupted"):
        worker.fly(Order(0, "name"), 60.0)
