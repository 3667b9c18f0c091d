"""Decoded captures as files: tables, pictures, pages."""
