"""CiA 402 (DSP402) drives: objects, states, PDO layouts, the drive client and the drive simulator.

Knows nothing of PROFIdrive.
"""
