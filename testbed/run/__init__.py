"""One run from its experiment to its verdict: fly, judge, replay, report."""
