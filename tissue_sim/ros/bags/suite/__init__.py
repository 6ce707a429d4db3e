"""The suite of bags that ship: what their scenes do, how they are recorded, what they show in figures."""
