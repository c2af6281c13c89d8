"""Motion capture on the wire: what lab systems send, and poses out of it."""
