"""What cannot be about a lab's network: an address for everybody without keys, keys without use."""

from collections.abc import Iterator
from pathlib import Path

from testbed.config.experiment import Experiment
from testbed.config.mistake import Mistake, show
from testbed.ops.network.badge import trouble


def bad_network(experiment: Experiment) -> Iterator[Mistake]:
    """All that is wrong with `[lab.network]`."""
    network = experiment.table.lab.network
    keys = Path(network.keys) if network.keys else None
    if (why := trouble(network.endpoint, keys)) is not None:
        at = ("table", "lab", "network", "endpoint")
        yield Mistake(at, why.partition("expected ")[2], show(network.endpoint))
