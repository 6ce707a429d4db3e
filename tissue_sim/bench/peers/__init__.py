"""What `tissue_sim bench tradeoff` sets side by side: the package's models and others, behind one interface."""
