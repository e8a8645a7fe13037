"""System identification: what a mechanism does, from recordings, and what its model lacks."""
