"""Control laws, one file per published law."""
