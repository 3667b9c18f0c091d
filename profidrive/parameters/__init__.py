"""Base Mode Parameter Access: codec, error numbers, PNU model, fault buffer."""
