"""Compiled inner loops (numba): arrays in, arrays out; no I/O, no objects, no threads of their own."""
