"""Whole gateways in virtual time, and the masters that they obey."""
