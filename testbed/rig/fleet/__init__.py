"""Vehicles of the twin whose ticks stay rows of numbers from the cameras to the log."""
