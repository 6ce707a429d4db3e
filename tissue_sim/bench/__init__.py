"""Run time against error, the paper's table, stability: what `tissue_sim bench` measures."""
