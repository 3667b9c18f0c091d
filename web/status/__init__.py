"""What the page knows of its gateway: status, events, fault counts, loads of the buses."""
