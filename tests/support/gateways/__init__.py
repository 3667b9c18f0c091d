"""Complete gateways in virtual time, and their masters."""
