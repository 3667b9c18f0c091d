"""Connections, access and large answers of the page."""
