"""Air-bearing testbed: core vocabulary, flight chain, operations and the operator's command."""
