"""Pure numbers of a flight: tracking, formation, admission."""
