"""The loop of one thread: timers, readiness, tasks and jobs, on the machine's clock or a virtual one."""
