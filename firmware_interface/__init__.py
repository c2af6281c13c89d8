"""Bytes to the boards."""
