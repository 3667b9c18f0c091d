"""Code for a PLC, made of a configuration: data types, frames, and function blocks of each kind of telegram."""
