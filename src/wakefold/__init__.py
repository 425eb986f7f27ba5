"""Wakefold tells, at every scale at once, what a moving agent is doing."""

__version__ = "0.1.0"
