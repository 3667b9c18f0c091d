"""Blocks of PROFINET IO as declarations, by service."""
