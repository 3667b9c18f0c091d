"""The ground of all packages: units of time, errors, texts, files that a user names, words for pydantic's errors."""
