"""What published documents say, and what the documents of this project say."""
