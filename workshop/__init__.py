"""Proofs and measurements of the product; not part of an installation."""
