"""All code that a flight needs is compiled before it begins, also that of its end.

A host of wired vehicles that compiles in flight is silent for seconds, and every vehicle stops. A
flight on the twin that compiles at its end does not answer `testbed stop` in time. On a machine
that has flown before, the code is read from the disk so quickly that it is not noticed; so this
counts what is asked for.
"""

import subprocess
import sys

import pytest

FLIES = """
import sys
from testbed.config import load, find
from testbed.core.whole_program import Entry
from testbed.rig.observers import NullObserver
from testbed.rig.twin import warm_up
from testbed.rig.wired.host import WireRig
from testbed.rig.wired.wired_flight import HostFlight

compiled, fly, flying = Entry.compile, HostFlight.fly, []

def compile(entry, sig):
    if flying and tuple(sig) not in entry.overloads:
        print("in flight:", entry.py_func.__name__)
    return compiled(entry, sig)

def begins(flight, *args):
    flying.append(True)
    return fly(flight, *args)

Entry.compile, HostFlight.fly = compile, begins
experiment = load(find(sys.argv[1]), sys.argv[2:])
warm_up(experiment)
ending = WireRig(experiment, bench=True).fly(NullObserver())
print("fault:", ending.fault and ending.fault.text)
"""


@pytest.mark.slow
@pytest.mark.parametrize(
    "words",
    [
        ["hold"],
        ["hold", 'inject=[{kind="nan_law", vehicle="sat1", at_s=60.0}]'],
        ["zhang2023_table"],
        ["zhang2023_table_wrench"],
    ],
)
def test_the_host_compiles_before_the_flight(words):
    words = [sys.executable, "-c", FLIES, *words, "duration_s=1"]
    found = subprocess.run(words, capture_output=True, text=True, check=True, timeout=400)
    assert found.stdout == "fault: None\n"


ENDS = """
import sys
from testbed.config import load, find
from testbed.core.whole_program import Entry
from testbed.rig.observers import NullObserver
from testbed.rig.twin import make_twin, warm_up

compiled, made = Entry.compile, []

def compile(entry, sig):
    if made and tuple(sig) not in entry.overloads:
        print("in flight:", entry.py_func.__name__)
    return compiled(entry, sig)

class Watched(NullObserver):
    ticks = None if sys.argv[1] == "tick by tick" else NullObserver.ticks

Entry.compile = compile
experiment = load(find(sys.argv[2]), sys.argv[3:])
warm_up(experiment)
made.append(rig := make_twin(experiment))
ending = rig.fly(Watched(), lambda: rig.twin.now > 4.0)
rig.come_to_rest(ending, Watched())
"""


@pytest.mark.slow
@pytest.mark.parametrize("way", ["tick by tick", "many ticks at once"])
@pytest.mark.parametrize(
    "words",
    [
        ["hold"],
        ["hold", "flight.ending.after=hold", "flight.ending.hold_s=2"],
        ["hold", 'inject=[{kind="stick_open", vehicle="sat1", jet=2, at_s=2.0}]'],
        ["zhang2023_table"],
        ["xue2022_table"],
    ],
)
def test_the_twin_compiles_before_the_flight(way, words):
    words = [sys.executable, "-c", ENDS, way, *words]
    found = subprocess.run(words, capture_output=True, text=True, check=True, timeout=400)
    assert found.stdout == ""
