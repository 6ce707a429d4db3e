"""A tool's topics, in and out."""
