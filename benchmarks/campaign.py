"""Overhead of a campaign beside its flights: Dask's share, two workers, memory, growth.

    python benchmarks/campaign.py [--runs 20] [--rounds 3] [--growth 0] [--jobs 2] [key=value ...]

The seeds of zhang2023's table run, flown by a plain loop in this process, by Dask with one worker
and with `--jobs` of them, one after the other and over again; the median round counts. Beside the
clock's time there is the processors' time of everybody together, which is of use where others share
the machine. The workers also count, one alone and all of them at once, which is what this machine
gives to programs that share nothing. `--growth N` flies N runs of half a second and prints what the
processes grew to.
"""

import argparse
import resource
import statistics
import time
from functools import partial

import tomli_w

from testbed.campaign.compilation import compile_first
from testbed.campaign.engine import WorkerPool, workers
from testbed.campaign.row import FlownRun
from testbed.campaign.trial import fly_batch, read, warm
from testbed.config import dump, find, load

COUNTED = 20_000_000  # about a second


def lost(task):
    return FlownRun(task[0], "lost")


def fleet(client, base):
    return WorkerPool(client, partial(fly_batch, base), lost, lambda run: run.wall_s, 3600.0)


def prepare(base):
    """Have the machine code made elsewhere, as a campaign does.

    A compiler keeps 300 MB, and a worker is counted with what its parent had.
    """
    compile_first(base, [(0, ())], read, warm, 3600.0)


def plain(base, tasks):
    """Clock and processor time of a loop [s]."""
    began, cpu = time.perf_counter(), time.process_time()
    fly_batch(base, tasks)
    return time.perf_counter() - began, time.process_time() - cpu


def through_dask(client, base, tasks):
    """Time through Dask: of this process, which includes the scheduler, and of all workers."""

    def spent():
        return time.process_time() + sum(client.run(time.process_time).values())

    began, cpu = time.perf_counter(), spent()
    assert sum(1 for _ in fleet(client, base).results(tasks)) == len(tasks)
    return time.perf_counter() - began, spent() - cpu


def count():
    """Seconds by the clock for a loop that needs no memory."""
    began, k = time.perf_counter(), 0
    while k < COUNTED:
        k += 1
    return time.perf_counter() - began


def scaling(client):
    """Times as fast as one worker that all of them are, when they only count."""
    names = list(client.scheduler_info(n_workers=-1)["workers"])
    alone = client.run(count, workers=names[:1]).values()
    return len(names) * sum(alone) / max(client.run(count).values())


def compare(runs, rounds, jobs, overrides):
    experiment = load(find("zhang2023_table"), overrides)
    base = tomli_w.dumps(dump(experiment))
    tasks = [(k, (f"seed={k}",)) for k in range(runs)]
    prepare(base)
    warm(base, tasks[:1])
    rows = {"plain loop": [], "Dask, 1 worker": [], f"Dask, {jobs} workers": []}
    counted = []
    with workers(1, None) as one, workers(jobs, None) as many:
        for client in (one, many):
            client.run(warm, base, tasks[:1])  # machine code is loaded off the clock
        for _ in range(rounds):
            rows["plain loop"].append(plain(base, tasks))
            rows["Dask, 1 worker"].append(through_dask(one, base, tasks))
            rows[f"Dask, {jobs} workers"].append(through_dask(many, base, tasks))
            counted.append(scaling(many))
        peak = max(many.run(lambda: resource.getrusage(resource.RUSAGE_SELF).ru_maxrss).values())
    flown = experiment.duration_s * runs
    print(f"{runs} runs of {experiment.duration_s:g} s, median of {rounds} rounds")
    print(f"{'':20}{'s':>8}{'runs/s':>9}{'x real time':>13}{'CPU s per run':>15}")
    for name, times in rows.items():
        wall, cpu = (statistics.median(column) for column in zip(*times, strict=True))
        print(f"{name:20}{wall:8.2f}{runs / wall:9.2f}{flown / wall:13.0f}{cpu / runs:15.3f}")
    loop, single, several = (list(zip(*times, strict=True)) for times in rows.values())
    by_clock = statistics.median(b / a - 1 for a, b in zip(loop[0], single[0], strict=True))
    by_cpu = statistics.median(b / a - 1 for a, b in zip(loop[1], single[1], strict=True))
    speed_up = statistics.median(a / b for a, b in zip(single[0], several[0], strict=True))
    print(f"Dask's overhead: {by_clock:+.1%} by the clock, {by_cpu:+.1%} in processor time")
    print(
        f"{jobs} workers are {speed_up:.2f} times as fast as one; a worker had {peak / 1024:.0f} MB"
    )
    print(f"when they only count they are {min(counted):.2f} to {max(counted):.2f} times as fast")


def grow(runs, jobs):
    base = tomli_w.dumps(dump(load(find("hold"), ["duration_s=0.5"])))
    prepare(base)
    seen, began = [], time.perf_counter()
    with workers(jobs, None) as client:
        for run in fleet(client, base).results([(k, (f"seed={k}",)) for k in range(runs)]):
            mine = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
            seen.append((run.memory_mb, mine))
    took = time.perf_counter() - began
    print(f"{runs} runs of 0.5 s in {took:.0f} s, {runs / took:.0f} a second; largest so far [MB]")
    print(f"{'after runs':>12}{'worker':>9}{'scheduler':>11}")
    for share in (0.1, 0.25, 0.5, 0.75, 1.0):
        part = seen[: max(1, round(share * runs))]
        worker, mine = (max(column) for column in zip(*part, strict=True))
        print(f"{len(part):12d}{worker:9.0f}{mine:11.0f}")


def main():
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--runs", type=int, default=20)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--growth", type=int, default=0)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("overrides", nargs="*", metavar="key=value")
    options = parser.parse_args()
    if options.runs:
        compare(options.runs, options.rounds, options.jobs, options.overrides)
    if options.growth:
        grow(options.growth, options.jobs)


if __name__ == "__main__":
    main()
