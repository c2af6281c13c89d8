"""`python -m testbed` is the command `testbed`."""

from testbed.cli.start import entry

if __name__ == "__main__":
    entry()
