"""From a log to a vehicle file, and from a vehicle file to a verdict on the twin."""
