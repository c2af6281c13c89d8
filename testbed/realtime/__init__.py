"""Clocks, pacing, scheduling and processes."""
