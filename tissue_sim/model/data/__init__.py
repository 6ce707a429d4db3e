"""Data that a tick reads and writes: records and their layout, settings, state, contact sets, arrays of a model."""
