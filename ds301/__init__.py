"""CANopen basics (CiA DS 301) that the drive and the encoder profile share.

Object declarations, PDO mapping and codec, EMCY and SDO abort tables, EDS output. Knows no device profile.
"""
