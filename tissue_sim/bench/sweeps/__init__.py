"""The stability sweep: cells, the trial that each one is, the map of their outcomes."""
