"""Filters: one file each; none imports another."""
