"""Simulators and the demo."""
