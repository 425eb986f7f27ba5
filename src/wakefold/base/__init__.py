"""What every package stands on: arrays on disk, executors, random numbers, units, compiling."""

__version__ = "0.1.0"
