"""One CAN bus: ports, sending and receiving, load and response times."""
