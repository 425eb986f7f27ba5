"""Compiled loops over the training points (numba): arrays in, arrays out."""
