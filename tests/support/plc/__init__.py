"""Programs of a PLC, and what PLCopen says about them."""
