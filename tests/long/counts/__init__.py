"""Counts of work that are the same on fast, slow and busy machines, compared with ``golden.toml``."""
