"""A small PROFINET IO controller."""
