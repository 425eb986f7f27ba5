"""How a scene of related objects is inferred."""
