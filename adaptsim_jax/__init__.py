"""Task-driven simulation adaptation (AdaptSim) and closing the loop with measured data, in JAX."""

__version__ = "0.1.0"
