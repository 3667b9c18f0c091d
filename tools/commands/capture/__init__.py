"""Commands for captures and recordings."""
