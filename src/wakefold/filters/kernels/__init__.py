"""Compiled loops of the filters (numba): arrays in, arrays out."""
