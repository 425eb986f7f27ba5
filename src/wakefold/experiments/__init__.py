"""The experiments of the papers: one module for each figure or number; ``wakefold reproduce`` runs them."""
