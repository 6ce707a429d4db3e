"""What `tissue_sim bench latency` runs beside the node."""
