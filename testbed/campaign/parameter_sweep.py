"""`testbed.sweep`: one experiment with many values and seeds, as a table."""

from collections.abc import Iterable, Iterator, Mapping
from itertools import combinations, product
from numbers import Real
from typing import Any

import numpy as np
import tomli_w

from testbed.campaign.fly_many import LIMIT_S, table_of
from testbed.campaign.process_pool import fly_in_processes
from testbed.campaign.sweep import SEED, covers
from testbed.campaign.trial import fly, read
from testbed.campaign.worker import Order
from testbed.config import Experiment, dump
from testbed.config.key import assignment
from testbed.core.error import TestbedError
from testbed.run.arguments import check_count, check_experiment, list_of, seeds_of, wrong
from testbed.run.experiment import told_by, toml
from testbed.run.table import Table


def sweep(
    experiment: Experiment,
    over: Mapping[str, Iterable[Any]] | None = None,
    seeds: Iterable[int] = range(1),
    jobs: int = 1,
) -> Table:
    """Fly an experiment with every combination of values, on every seed, without logs.

    Args:
        experiment: from `testbed.load`.
        over: values by dotted key: `{"controller.k": [0.2, 0.3]}`; not `seed`, and no key that a
            later one overwrites.
        seeds: each combination flies with each of these.
        jobs: processes that fly at the same time; 1: fly in this process.

    Returns:
        One row per run, in the order of combinations and seeds: the values, `seed`, `outcome`
        ("passed", "failed", "fault", "error", "refused", "lost"), `reason`, and the metrics.
        `settle_s` is the worst vehicle's, `sat1.settle_s` one vehicle's. NaN where a number does
        not apply. If `duration_s` is one of the keys, the duration that was flown is `flown_s`.

    Raises:
        TestbedError: a key, value or seed is not possible.
    """
    check_experiment("testbed.sweep", experiment)
    if not isinstance(over or {}, Mapping):
        raise wrong("testbed.sweep, over", 'values by key: {"controller.k": [0.2, 0.3]}', over)
    axes = {
        key: list_of(f"testbed.sweep, over[{key!r}]", values, "a list of values: [0.2, 0.3]")
        for key, values in (over or {}).items()
    }
    check_count("testbed.sweep, jobs", jobs, "a number of processes, 1 or more")
    numbers = seeds_of("testbed.sweep, seeds", seeds)
    _check_keys(axes)
    rows = [(values, seed) for values in product(*axes.values()) for seed in numbers]
    base = tomli_w.dumps(dump(experiment))
    orders = [
        Order(k, base, (*_overrides(axes, values), f"seed={s}"))
        for k, (values, s) in enumerate(rows)
    ]
    for values in dict.fromkeys(order.overrides[:-1] for order in orders):
        with told_by("testbed.sweep, over"):
            read(base, values)  # a wrong key is refused before the first flight
    if jobs == 1:
        runs = [fly(base, one.k, one.overrides) for one in orders]
    else:
        runs = fly_in_processes(orders, jobs, LIMIT_S)
    columns: dict[str, Any] = {
        key: _column([values[k] for values, _ in rows]) for k, key in enumerate(axes)
    }
    columns["seed"] = np.array([seed for _, seed in rows], dtype=np.int64)
    return table_of(columns, runs)


def _check_keys(axes: Mapping[str, list[Any]]) -> None:
    """Refuse keys whose column would not be what was flown."""
    keys = {}
    for text, values in axes.items():
        try:
            keys[text] = assignment(f"{text}=0")[0]
        except ValueError:
            continue  # refused with the experiment, which says more
        if keys[text] == SEED:  # it has a column and an argument of its own
            raise TestbedError(
                where="testbed.sweep, over", expected="keys other than seed", found=repr(text),
                hint=f"seeds={values!r}",
            )  # fmt: skip
    for (one, key), (other, later) in combinations(keys.items(), 2):
        if covers(later, key):
            raise TestbedError(
                where="testbed.sweep, over", expected=f"{one!r} that no other key overwrites",
                found=f"{other!r} after it", hint="give the wider key first, or one of them",
            )  # fmt: skip


def _overrides(keys: Iterable[str], values: Iterable[Any]) -> Iterator[str]:
    for key, value in zip(keys, values, strict=True):
        yield f"{key}={toml(value, f'testbed.sweep, over[{key!r}]')}"


def _column(values: list[Any]) -> np.ndarray:
    if all(isinstance(value, Real) and not isinstance(value, bool) for value in values):
        return np.array(values)
    plain = all(isinstance(value, int | float | str | bool) for value in values)
    if plain and len({type(value) for value in values}) <= 1:
        return np.array(values)
    column = np.empty(len(values), dtype=object)
    column[:] = values
    return column
