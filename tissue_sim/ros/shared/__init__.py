"""What the node and the programs beside it share."""
