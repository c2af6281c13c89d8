r"""Errors and settling times of gao2022's five formations on the twin, over seeds.

    python benchmarks/gao2022_table.py [--seeds 0:20] [--starts drawn|shipped] [key=value ...]
    python benchmarks/gao2022_table.py --seeds 100:200
    python benchmarks/gao2022_table.py --seeds 100:130 \
        guidance.mode=reference guidance.force_share=0.8 deploy.law=host

The whole chain: cameras, radio, estimator, jets. A seed draws the vehicles, the noise and, with
`--starts drawn`, where they start: anywhere within 2.4 m of the centre on each axis, at least
0.7 m from each other. A phase is formed if in its last 5 s no vehicle is further than 0.10 m from
the curve; settled is when that begins for good.
"""

import argparse
from time import perf_counter

import numpy as np

from controllers.bifurcating_design import distance_to
from testbed.config import find, load
from testbed.metrics.run_metrics import Track, smallest_separation
from testbed.rig.observers import NullObserver
from testbed.rig.twin import make_twin

FORMED = 0.10  # [m]
END = 5.0  # of a phase, that counts [s]
HALF, APART = 2.4, 0.7  # drawn starts [m]


def draw_starts(seed: int, count: int) -> np.ndarray:
    """Places on the table, shape (count, 2) [m]."""
    rng = np.random.default_rng([seed, 2022])
    while True:
        p = rng.uniform(-HALF, HALF, (count, 2)).round(3)
        gaps = np.hypot(*(p[:, None] - p[None]).T)[np.triu_indices(count, 1)]
        if gaps.min(initial=np.inf) >= APART:
            return p


def started(seed: int, names: list[str]) -> list[str]:
    """Overrides that put the vehicles where the seed says."""
    places = zip(names, draw_starts(seed, len(names)).tolist(), strict=True)
    return [
        f"vehicles.{name}.{which}=[{x}, {y}, 0.0]"
        for name, (x, y) in places
        for which in ("start", "goal")
    ]


def phase_errors(track: Track, params, duration: float) -> list[tuple[float, float | None]]:
    """Worst error at the end [m] and settle time [s] of each phase."""
    rows = []
    ends = [*(phase.at for phase in params.phases[1:]), duration]
    for phase, end in zip(params.phases, ends, strict=True):
        inside = (track.t >= phase.at) & (track.t <= end)
        t = track.t[inside]
        error = distance_to(phase.shape, track.states[inside][::10, :, :2]).max(axis=1)
        t = t[::10]
        late = np.nonzero(error > FORMED)[0]
        settled = None if len(late) and late[-1] == len(t) - 1 else t[late[-1] + 1] - phase.at
        rows.append((float(error[t >= end - END].max()), settled))
    return rows


def main() -> None:
    """Fly and print."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--seeds", default="0:20", help="lo:hi, hi not included")
    parser.add_argument("--starts", choices=("drawn", "shipped"), default="drawn")
    parser.add_argument("--experiment", default="gao2022_table")
    parser.add_argument("overrides", nargs="*", metavar="key=value")
    options = parser.parse_args()
    lo, hi = map(int, options.seeds.split(":"))
    names = list(load(find(options.experiment)).vehicles)
    formed, contacts, gaps, errors, settles = 0, 0, [], [], []
    for seed in range(lo, hi):
        starts = started(seed, names) if options.starts == "drawn" else []
        overrides = [*starts, *options.overrides, f"seed={seed}"]
        experiment = load(find(options.experiment), overrides)
        rig = make_twin(experiment)
        began = perf_counter()
        ending = rig.fly(NullObserver())
        wall = perf_counter() - began
        track, touches = rig.track(), len(rig.twin.plant.touches)
        contacts += touches
        radius = experiment.vehicles[names[0]].model.radius  # they are all alike
        gaps.append(smallest_separation(track) - 2.0 * radius)
        if ending.fault:
            print(f"seed {seed}: {ending.fault.words}", flush=True)
            continue
        rows = phase_errors(track, experiment.controller, experiment.duration_s)
        good = all(error <= FORMED for error, _ in rows) and touches == 0
        formed += good
        errors.append([error for error, _ in rows])
        settles.append([np.nan if settled is None else settled for _, settled in rows])
        impulse = sum(rig.spent(name).impulse for name in names)
        print(
            f"seed {seed}: {'formed' if good else 'NOT FORMED'}, errors "
            + " ".join(f"{1e3 * error:.0f}" for error, _ in rows)
            + " mm, settled "
            + " ".join("never" if s is None else f"{s:.0f}" for _, s in rows)
            + f" s, gap {gaps[-1]:.3f} m, contacts {touches}, {impulse:.0f} N s, {wall:.1f} s",
            flush=True,
        )
    print(f"\n{formed} of {hi - lo} formed, {contacts} contacts, smallest gap {min(gaps):.3f} m")
    if errors:
        shapes = [phase.shape for phase in experiment.controller.phases]
        for k, shape in enumerate(shapes):
            e, s = np.array(errors)[:, k], np.array(settles)[:, k]
            print(
                f"{shape:12s} error worst {1e3 * e.max():.1f} mm, median {1e3 * np.median(e):.1f}; "
                f"settled 95 % {np.nanpercentile(s, 95):.1f} s, slowest {np.nanmax(s):.1f} s"
            )


if __name__ == "__main__":
    main()
