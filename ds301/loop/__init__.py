"""The loop of one thread: timers, sockets and tasks, in real or virtual time."""
