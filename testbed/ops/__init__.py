"""Everything with a clock, a file or a screen."""
