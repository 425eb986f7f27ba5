"""Compiled loops of the linkage (numba): arrays in, arrays out."""
