"""Local regions: the nodes that move, and the representation of the rest of the organ."""
