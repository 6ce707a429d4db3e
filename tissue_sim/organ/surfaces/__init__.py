"""The organ's wall, marching cubes and the balloon on it, and how good they are."""
