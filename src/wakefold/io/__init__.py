"""Readers and writers of tracks, and of named places."""

from wakefold.io.read import read_tracks
from wakefold.io.report import Offence, ReadError, Report
from wakefold.io.write import write_tracks

__all__ = ["Offence", "ReadError", "Report", "read_tracks", "write_tracks"]
