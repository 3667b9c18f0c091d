"""Output of the commands: tables, status, reports, files."""
