"""Drives for tests: on a test bench, from data sheets, and with wrong reports."""
