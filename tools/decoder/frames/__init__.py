"""Frames and packets of both buses to records."""
