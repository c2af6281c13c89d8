"""Fault injection: injected faults and their results."""
