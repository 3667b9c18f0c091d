"""Decoded captures as data sets, tables, pictures and pages."""
