"""The core of diagnosis, which knows numbers with names: what is missing, what is left, and how it is told."""
