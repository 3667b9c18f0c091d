"""Status port, service manager, cycle times and real time."""
