"""Assembly of flight chain, twin and hardware: which adapter is connected to what."""
