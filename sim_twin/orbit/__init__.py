"""Satellites in orbit: relative dynamics as the papers use them, and two-body + J2 in ECI."""
