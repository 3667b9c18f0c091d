"""Recordings of both buses: recorder, files, and opening them for timeline and replay."""
