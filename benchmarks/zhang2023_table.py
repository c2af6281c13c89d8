"""The figures of zhang2023's table experiment on the twin, worst and median over seeds.

    python benchmarks/zhang2023_table.py [--seeds 20] [key=value ...]

Prints one row of a Markdown table per variant.
"""

import argparse
import statistics
import tempfile
from pathlib import Path

from testbed.config import find, load
from testbed.run.fly import fly_and_judge

VARIANTS = (
    ("reference mode", "zhang2023_table", ()),
    ("wrench mode", "zhang2023_table_wrench", ()),
    ("wrench mode, 0.05 s jet period", "zhang2023_table_wrench", ("flight.jet_period_s=0.05",)),
    ("reference mode, plain PWM", "zhang2023_table", ("flight.modulator={type='pwm'}",)),
    ("reference mode, PWPF", "zhang2023_table", ("flight.modulator={type='pwpf'}",)),
    ("wrench mode, plain PWM", "zhang2023_table_wrench", ("flight.modulator={type='pwm'}",)),
    ("wrench mode, PWPF", "zhang2023_table_wrench", ("flight.modulator={type='pwpf'}",)),
)
COLUMNS = (  # heading, key, factor, format, which end is worst
    ("hold RMS [mm]", "hold_rms_m", 1e3, "{:.2f}", max),
    ("tracking RMS [mm]", "track_rms_m", 1e3, "{:.2f}", max),
    ("heading RMS [deg]", "heading_rms_deg", 1.0, "{:.3f}", max),
    ("settled [s]", "settle_s", 1.0, "{:.1f}", max),
    ("nearest obstacle [m]", "min_obstacle_distance_m", 1.0, "{:.3f}", min),
    ("impulse [N s]", "impulse_ns", 1.0, "{:.1f}", max),
    ("valve pulses", "valve_pulses", 1.0, "{:.0f}", max),
)


def main() -> None:
    """Fly all variants and print."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("overrides", nargs="*", metavar="key=value")
    options = parser.parse_args()
    headings = ["variant", "contacts", *(h for h, *_ in COLUMNS), "x real time"]
    print(f"Worst (median) of {options.seeds} seeds and three vehicles each.\n")
    print("| " + " | ".join(headings) + " |")
    print("|" + "---|" * len(headings))
    for label, name, overrides in VARIANTS:
        runs = []
        for seed in range(options.seeds):
            experiment = load(find(name), [*overrides, *options.overrides, f"seed={seed}"])
            with tempfile.TemporaryDirectory() as folder:
                runs.append(fly_and_judge(experiment, Path(folder)))
        cells = [label, str(sum(run.contacts for run in runs))]
        for _, key, factor, form, worst in COLUMNS:
            values = [getattr(m, key) for run in runs for m in run.vehicles.values()]
            if None in values:
                cells.append("-" if all(v is None for v in values) else "not always")
                continue
            ends = [worst(values), statistics.median(values)]
            cells.append("{} ({})".format(*(form.format(factor * v) for v in ends)))
        factors = [run.real_time_factor or 0.0 for run in runs]
        cells.append(f"{min(factors):.0f} ({statistics.median(factors):.0f})")
        print("| " + " | ".join(cells) + " |", flush=True)


if __name__ == "__main__":
    main()
