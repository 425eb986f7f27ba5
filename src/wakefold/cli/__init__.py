"""The command line: one file a command; parse, call, print."""

from wakefold.cli.app import app, main

__all__ = ["app", "main"]
