"""Mechanisms on a fixed base: trees of hinge and slide joints, read from MJCF or URDF, with their
dynamics in JAX.
"""
