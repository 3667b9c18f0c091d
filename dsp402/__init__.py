"""CiA 402 drives: objects, states, modes, and the type of a drive as one value.

Knows nothing of PROFIdrive.
"""
