"""Executors: a ``Demand`` to objects of a drive, its feedback to a ``Report``; no telegram."""
