"""Bus scan and telegram check."""
