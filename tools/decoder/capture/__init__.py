"""Capture files, streams and interfaces: readers, and writers of decoded records."""
