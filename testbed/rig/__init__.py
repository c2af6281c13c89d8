"""Assembly of flight chain, twin and hardware; the only package that imports all others."""
