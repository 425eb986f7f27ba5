"""From tracks to their tree: Fréchet distances, spanning tree, dendrogram."""
