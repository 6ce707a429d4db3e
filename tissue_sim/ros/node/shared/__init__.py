"""What the node's parts share: what it serves, its clock, callbacks that are guarded."""
