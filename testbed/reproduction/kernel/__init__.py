"""Compiled code, cached on disk, see `testbed.core.compiled`."""
