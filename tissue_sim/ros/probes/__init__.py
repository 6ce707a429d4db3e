"""What benchmarks of the node run beside it, and how they ask it."""
