"""Files, streams and interfaces around the decoder: readers of captures, writers of what was decoded."""
