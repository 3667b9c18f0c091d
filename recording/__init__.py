"""Recordings of both buses: the recorder, its files, and what opens them again."""
