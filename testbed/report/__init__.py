"""Charts, figures and pages of runs."""
