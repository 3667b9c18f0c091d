"""One application relationship: Connect, state machine and cyclic data."""
