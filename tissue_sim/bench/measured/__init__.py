"""Bodies that others have measured, built, calibrated and moved as organs are."""
