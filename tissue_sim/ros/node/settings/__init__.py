"""Parameters that change while the node runs, and what it gives up under load."""
