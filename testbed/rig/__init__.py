"""Who is plugged into what: the only package that knows everybody."""
