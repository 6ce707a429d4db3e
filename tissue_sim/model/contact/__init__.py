"""Contact of the tissue with rigid tools: shapes, gaps, the constraint with friction, the haptic output."""
