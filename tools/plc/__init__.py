"""Generate code for a PLC from a configuration: data types, frames, and a function block for each telegram."""
