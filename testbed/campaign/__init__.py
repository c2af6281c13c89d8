"""Many runs of one experiment: sweeps, tuning, the benchmark of record.

A campaign is a list of runs. A run is a base experiment with "key=value" overrides, as on the
command line. `testbed.campaign.trial` flies one run; the other modules plan the runs, distribute
them, store them and summarise them.
"""
