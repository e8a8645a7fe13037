"""Recordings of mechanisms, read from the files that people have."""
