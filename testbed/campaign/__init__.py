"""Many runs of one experiment: sweeps, tuning, the benchmark of record.

A campaign is a list of runs, and a run is a base experiment and some "key=value" on top, as on the
command line. What flies a run is in `testbed.campaign.trial`; everything else here is about which
runs there are, who flies them, what is kept of them and what they say together.
"""
