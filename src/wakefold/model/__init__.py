"""What is learned from past tracks: the filtration, the dynamics of its classes, how agents stray."""
