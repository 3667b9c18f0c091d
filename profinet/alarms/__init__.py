"""Alarms of a relationship, and diagnosis."""
