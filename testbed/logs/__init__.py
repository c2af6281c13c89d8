"""The log of a run: recorder, reader, export, replay."""
