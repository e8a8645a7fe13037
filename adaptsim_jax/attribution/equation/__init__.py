"""Equation error: the balance of forces along the measured motion, in which nothing is
simulated.
"""
