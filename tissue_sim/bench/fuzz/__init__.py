"""`tissue_sim bench fuzz`: hostile input, case by case, in processes that may die of it."""
