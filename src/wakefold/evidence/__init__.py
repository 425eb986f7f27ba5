"""What an observation says, at any resolution."""
