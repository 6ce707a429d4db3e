"""Local regions: which nodes move, and what stands for the rest of the organ."""
