"""Elastic forces of springs and cells, gravity, and how a model is assembled from an organ."""
