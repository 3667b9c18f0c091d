"""Captures, and independent readers of them."""
