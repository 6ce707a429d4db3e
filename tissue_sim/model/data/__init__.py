"""What a tick reads and writes: records and their layout, settings, state, contact sets, the arrays of a model."""
