"""What of the records the reader sees: names, filters, columns, texts, statistics."""
