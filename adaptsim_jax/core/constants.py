"""Constants of nature that the models share."""

GRAVITY = 9.81
"""Standard gravity, m/s^2: of every model and recording that says nothing else."""
