"""Drives: simulated ones on a desk, such as data sheets describe, and such as lie."""
