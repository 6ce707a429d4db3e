"""Scenes that no hand and no machine would mean: tools, loads, messages and settings, all at once."""
