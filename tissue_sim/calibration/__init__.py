"""How an organ gets the stiffness of its tissue: finite elements of its shape, the fit, its judgement."""
