"""The medial skeleton: a centreline with branches, and the atoms along it."""
