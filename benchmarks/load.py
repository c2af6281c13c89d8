"""Processes that only compute, so that a benchmark runs on a busy machine."""

import subprocess
import sys
from contextlib import contextmanager


@contextmanager
def loaded(count):
    """Keep so many processes busy in this context."""
    hogs = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(count)]
    try:
        yield
    finally:
        for hog in hogs:
            hog.kill()
            hog.wait()
