"""Alarms of a relationship, and the diagnosis that they report."""
