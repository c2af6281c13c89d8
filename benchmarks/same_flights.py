"""Are the flights of today those of another version, to the last bit?

    python benchmarks/same_flights.py save FILE       # with the version before
    python benchmarks/same_flights.py compare FILE    # with the version after

Every shipped experiment flies on three seeds, 20 injected faults fly on two experiments, and
`reproduce all --quick` is run. Kept are the true trajectory up to the end of each flight, the
metrics, and the numbers of the audit; sentences may be worded anew and are counted apart.
"""

import json
import subprocess
import sys
from pathlib import Path

import msgspec
import numpy as np
from msgspec.structs import replace

from testbed.config import SHIPPED, ConfigError, Experiment, find, load
from testbed.core.fault_injection import Injection
from testbed.rig.observers import MetricsObserver
from testbed.rig.twin import make_twin
from testbed.run.judge import measure

SEEDS = (0, 1, 2)
LONGEST_S = 60.0  # of a flight that is compared
KINDS = (
    "drop_mocap", "freeze_mocap", "swap_bodies", "stick_open", "stick_closed", "brown_out", "leak",
    "delay_link", "lose_link", "nan_law", "kill_process",
)  # fmt: skip


def cases():
    """Name and experiment of every flight."""
    for file in sorted((SHIPPED / "experiments").glob("*.toml")):
        for seed in SEEDS:
            experiment = load(find(file.stem), [f"seed={seed}"])
            yield f"{file.stem} seed {seed}", shortened(experiment)
    for k in range(20):
        base = load(find(("zhang2023_table", "zhang2023_table_wrench")[k % 2]), [f"seed={k}"])
        kind = KINDS[k % len(KINDS)]
        what = Injection(
            kind=kind, vehicle="sat1", at_s=2.0 + k / 7, jet=1 + k % 8,
            other="sat2" if kind == "swap_bodies" else "",
            for_s=2.0 if kind in ("drop_mocap", "delay_link", "lose_link") else 1e6,
        )  # fmt: skip
        yield f"{kind} {k}", replace(base, duration_s=20.0, inject=[what])


def shortened(experiment: Experiment) -> Experiment:
    """The experiment, at most LONGEST_S long."""
    return replace(experiment, duration_s=min(experiment.duration_s, LONGEST_S))


def fly(experiment: Experiment):
    """True trajectory and metrics of one flight on the twin."""
    rig, observer = make_twin(experiment), MetricsObserver(experiment.vehicles)
    ending = rig.fly(observer)
    metrics = measure(rig, observer.aims, ending, 0.0, completed=ending.fault is None)
    track = rig.track()
    judged = track.t <= ending.t + 1e-9
    numbers = msgspec.to_builtins(metrics)
    return np.column_stack([track.t[judged], track.states[judged].reshape(judged.sum(), -1)]), {
        "numbers": flat(numbers), "words": flat(numbers, words=True), "t": ending.t,
    }  # fmt: skip


def flat(value, at="", *, words=False):
    """Every number, or every sentence, of a tree by its path."""
    if isinstance(value, dict):
        pairs = value.items()
    elif isinstance(value, list | tuple):
        pairs = enumerate(value)
    else:
        return {at: value} if isinstance(value, str) == words and value is not None else {}
    found = {}
    for key, one in pairs:
        found |= flat(one, f"{at}.{key}" if at else str(key), words=words)
    return found


def audit():
    """Numbers of the audit of the papers, by the claim's name."""
    words = [sys.executable, "-m", "testbed", "reproduce", "all", "--quick", "--json"]
    text = subprocess.run(words, capture_output=True, text=True, check=False).stdout
    return flat(json.loads(text))


def collect():
    """Everything."""
    tracks, rest = {}, {}
    for name, experiment in cases():
        try:
            tracks[name], rest[name] = fly(experiment)
        except ConfigError as error:
            tracks[name], rest[name] = np.zeros((0, 1)), {"refused": str(error)}
        print(f"{name}: {len(tracks[name])} states", file=sys.stderr, flush=True)
    return tracks, rest | {"reproduce": audit()}


def main() -> int:
    """Save, or compare."""
    verb, file = sys.argv[1], Path(sys.argv[2])
    tracks, rest = collect()
    if verb == "save":
        np.savez_compressed(file, rest=json.dumps(rest), **tracks)
        return 0
    saved = np.load(file)
    before = json.loads(str(saved["rest"]))
    rest = json.loads(json.dumps(rest))
    moved = [n for n in tracks if n not in saved or not np.array_equal(tracks[n], saved[n])]
    print(f"true trajectories: {len(tracks) - len(moved)} of {len(tracks)} equal to the last bit")
    for name in moved:
        print(f"  moved: {name}")
    for kind in ("numbers", "words"):
        other = {
            name: [k for k, v in one[kind].items() if k in before[name][kind]
                   and before[name][kind][k] != v]
            for name, one in rest.items() if kind in one and kind in before.get(name, {})
        }  # fmt: skip
        differ = {name: keys for name, keys in other.items() if keys}
        print(f"metrics, {kind}: {len(other) - len(differ)} of {len(other)} flights equal")
        for name, keys in differ.items():
            print(f"  {name}: {', '.join(keys[:6])}")
    a, b = before["reproduce"], rest["reproduce"]
    both = sorted(a.keys() & b.keys())
    other = [k for k in both if a[k] != b[k]]
    print(f"reproduce: {len(both) - len(other)} of {len(both)} numbers that both have are equal")
    for key in other:
        print(f"  {key}: {a[key]} before, {b[key]} now")
    return int(bool(moved))


if __name__ == "__main__":
    sys.exit(main())
