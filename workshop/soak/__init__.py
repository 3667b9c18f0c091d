"""Random lives of a gateway in virtual time, held against what must never happen."""
