"""Compiled code of the tracks."""
