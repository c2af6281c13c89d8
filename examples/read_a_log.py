"""Open the folder of a run and look at its columns; without a folder, fly a short run first."""

import sys
from tempfile import TemporaryDirectory

import testbed

with TemporaryDirectory() as home:
    folder = sys.argv[1] if len(sys.argv) > 1 else f"{home}/run"
    if len(sys.argv) < 2:
        testbed.fly(testbed.load("hold", "duration_s=10", "criteria={}", seed=5), log=folder)
    run = testbed.open_run(folder)
    print(run)
    for name in run:
        table = run.table(name)
        print(f"{name}: {table.rows} rows")
        for column, values in table.items():
            print(f"  {column:<18}{table.units[column]:<7}last {values[-1]:.6g}")
    same = testbed.replay(run).first_difference is None
    print("replayed bit for bit" if same else "this code flies differently")
