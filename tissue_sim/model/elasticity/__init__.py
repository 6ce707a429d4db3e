"""Elastic forces of springs and cells, gravity, and the assembly of a model from an organ."""
