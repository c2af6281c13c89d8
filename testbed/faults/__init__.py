"""Fault injection: what is injected, and what became of it."""
