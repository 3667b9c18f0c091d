"""Status, events, fault counts and bus loads for the page."""
