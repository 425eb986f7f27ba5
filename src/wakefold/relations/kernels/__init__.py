"""Compiled loops of the relational filters (numba): arrays in, arrays out."""
