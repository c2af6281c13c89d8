"""The processes of a run on real wires: the twin's server, a vehicle's, the host's."""
