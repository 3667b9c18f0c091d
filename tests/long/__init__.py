"""Verification and measurement of the product; not part of an installation."""
