"""The decoder: bytes of both buses to named values, without I/O.

``recognise`` tells what a piece of data is and why; its documents are plain data with a stable schema
(docs/decoder-schema.md). Captures, timeline and replay are not here yet.
"""
