"""Benchmark `tissue_sim bench cut`: the error of a cut organ against finite elements, and the time of a cut."""
