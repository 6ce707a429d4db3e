"""A haptic bridge that plays a script."""
