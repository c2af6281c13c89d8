"""The live picture: rerun scene, viewer, feeder."""
