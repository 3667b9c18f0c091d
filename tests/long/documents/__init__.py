"""Generators of documents: tables and pictures."""
