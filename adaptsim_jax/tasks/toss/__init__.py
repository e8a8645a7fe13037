"""A body tossed onto a plane, seen by motion capture: what the declared MJCF lacks. Simulated by
MuJoCo in C; there is no policy.
"""
