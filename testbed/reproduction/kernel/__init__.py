"""The compiled part: what is here is kept on disk, see `testbed.core.compiled`."""
