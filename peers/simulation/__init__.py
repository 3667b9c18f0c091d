"""Simulated devices on one bus: which there are, the file that describes them, and how they are controlled at run time."""
