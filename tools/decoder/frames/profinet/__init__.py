"""Frames and calls of PROFINET to records."""
