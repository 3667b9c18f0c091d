"""CiA 301 for both device profiles: object declarations, PDO codec, tables of EMCY, SDO aborts and NMT.

Object declarations, PDO mapping and codec, EMCY and SDO abort tables, EDS output. Knows no device profile.
"""
