"""Executors: a ``Demand`` to the objects of a drive, and what the drive shows to a ``Report``. They know no telegram."""
