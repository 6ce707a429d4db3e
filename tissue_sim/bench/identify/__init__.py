"""Benchmark of the identification: measured presses, and presses made by finite elements."""
