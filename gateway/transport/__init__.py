"""Transports: how cyclic frames and parameter requests reach the gateway."""
