"""One vehicle's flight chain, pure: no clock, no socket, no file, no randomness."""
