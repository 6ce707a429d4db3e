"""Cuts of an organ of cells: the sheet, the cells that it divides, virtual nodes, and the new surface."""
