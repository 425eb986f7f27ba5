"""Questions about held-out tracks, the methods that answer them, and scores of the answers."""
