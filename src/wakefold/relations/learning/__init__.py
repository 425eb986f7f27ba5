"""Constants of relations, learned from scenes."""
