"""Memory of a flight, in a process of its own: what is kept is kept for good."""

import platform
import subprocess
import sys

import pytest

ASKS = """
import gc, resource
import numpy as np
from testbed.realtime.scheduling import steady_memory

def pages():
    before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    for _ in range(10):
        [np.ones(100_000) for _ in range(15)]  # 800 kB each, as a table of ticks
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before

first = pages()
with steady_memory():
    print(gc.isenabled(), end=" ")
    pages()
    print(first, pages(), end=" ")
print(gc.isenabled())
"""


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="another C library keeps its own way")
def test_a_flight_asks_the_system_for_memory_once():
    done = subprocess.run([sys.executable, "-c", ASKS], capture_output=True, text=True, check=True)
    during, without, kept, after = done.stdout.split()
    assert (during, after) == ("False", "True")
    assert int(kept) < 200 < int(without)
