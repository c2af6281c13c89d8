"""The live dashboard: rerun scene, viewer, feeder."""
