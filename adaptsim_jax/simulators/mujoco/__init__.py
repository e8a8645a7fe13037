"""Whatever MuJoCo compiles, over a recording: at the file's own time step and integrator, its
numbers named by field.
"""
