"""One axis machine, stepped by hand or joined to a simulated drive."""
