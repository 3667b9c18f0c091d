"""What commands print and write: tables, status, reports, files."""
