"""The valve boards: firmware, serial protocol, sessions and emulators."""
