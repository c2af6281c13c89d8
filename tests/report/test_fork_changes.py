"""The report names what a fork changes: gains with both values, another law by name."""

from testbed.config import find, load
from testbed.report.fork_changes import fork_changes
from testbed.run.fork import forked

ARROW = "\N{RIGHTWARDS ARROW}"


def test_other_gains_have_their_old_and_new_value():
    base = load(find("zhang2023_table"))
    old = base.controller.k
    fork = forked(base, 4.0, ["controller.k=0.002"])
    assert fork_changes(fork) == [f"From 4 s on: other gains, controller.k {old:g} {ARROW} 0.002."]
    again = forked(fork, 6.0, ["controller.k=0.003", "flight.tracker.bandwidth=1.25", "seed=9"])
    width = base.flight.tracker.bandwidth
    assert fork_changes(again)[1] == (
        f"From 6 s on: other gains, controller.k 0.002 {ARROW} 0.003; "
        f"flight.tracker.bandwidth {width:g} {ARROW} 1.25; seed 0 {ARROW} 9."
    )


def test_another_law_is_called_so():
    fork = forked(load(find("hold")), 4.0, ['controller={type="lqr"}'])
    (said,) = fork_changes(fork)
    assert "another law, " in said
    assert f"{ARROW} lqr" in said
    assert "gains" not in said


def test_a_fork_of_a_fault_alone_says_that_it_changes_no_value():
    fault = 'inject=[{kind="leak", vehicle="sat1", at_s=5.0}]'
    (said,) = fork_changes(forked(load(find("hold")), 4.0, [fault]))
    assert said == "From 4 s on: a fork without changes of law, chain or seed."


def test_one_value_of_a_list_is_named_by_its_place():
    base = forked(load(find("zhang2023_table")), 2.0, ["controller.lambda=[1.0, 1.0]"])
    fork = forked(base, 4.0, ["controller.lambda=[1.0, 1.2]"])
    assert fork_changes(fork)[0].endswith(f"controller.lambda 1 {ARROW} (1.0, 1.0).")
    assert fork_changes(fork)[1].endswith(f"other gains, controller.lambda.2 1 {ARROW} 1.2.")
