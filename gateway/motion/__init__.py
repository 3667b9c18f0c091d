"""What moves an axis beside a plain speed or task: length units, traversing blocks, the positioner, DSC, message words.

Pure: values and monotonic nanoseconds in, values out; nothing here knows a telegram's word or a drive's Controlword.
"""
