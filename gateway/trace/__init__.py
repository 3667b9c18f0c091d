"""The flight recorder: layout of the ring file, writer and reader."""
