"""The contact search beside the loop."""
