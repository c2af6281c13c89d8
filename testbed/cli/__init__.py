"""Command-line verbs of `testbed`."""
