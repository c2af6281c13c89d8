"""Motion capture: protocols of lab systems, and poses from their data."""
