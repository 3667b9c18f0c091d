"""Names, filters, columns, texts and statistics of records."""
