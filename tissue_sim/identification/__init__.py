"""Identification of an organ's stiffness from measured presses: fit, uncertainty, and what the model can't explain."""
