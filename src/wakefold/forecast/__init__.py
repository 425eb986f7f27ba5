"""Questions about held-out tracks, scores, and plain rivals."""
