"""Positioner (states as data, traversing blocks, length units), DSC and message words; pure.

Pure: values and monotonic nanoseconds in, values out; nothing here knows a telegram's word or a drive's Controlword.
"""
