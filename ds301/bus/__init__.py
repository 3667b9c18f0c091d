"""One CAN bus: opening it, sending and receiving its frames, its load and its response times."""
