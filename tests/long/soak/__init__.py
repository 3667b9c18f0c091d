"""Random operation of a gateway in virtual time, checked against the safety rules."""
