"""Tracks: timed sequences of positions, their shaping and their plane."""
