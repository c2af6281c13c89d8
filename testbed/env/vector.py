"""Many environments of one vehicle, stepped together."""

from functools import partial
from typing import Any

from gymnasium.vector import AsyncVectorEnv, SyncVectorEnv, VectorEnv

from testbed.config import Experiment
from testbed.env.table import TableEnv
from testbed.run.arguments import check_count


def table_envs(
    experiment: Experiment, number: int, *, processes: bool = False, **options: Any
) -> VectorEnv[Any, Any, Any]:
    """So many `TableEnv`s as one vector environment of Gymnasium.

    `reset(seed=s)` gives environment k the seed s + k, and its episodes are those of a `TableEnv`
    alone with that seed, to the last bit.

    Args:
        experiment: see `TableEnv`.
        number: of environments.
        processes: each steps in a process of its own; else one after the other.
        options: of `TableEnv`.

    Raises:
        TestbedError: `number` is not a whole number from 1.
    """
    check_count("table_envs", number, "one environment or more")
    makers = [partial(TableEnv, experiment, **options)] * number
    if not processes:
        return SyncVectorEnv(makers)
    # a forked process would have this one's locks, but not its threads
    return AsyncVectorEnv(makers, context="forkserver")
