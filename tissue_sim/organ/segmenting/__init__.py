"""From a CT and one seed to the mask of an organ."""
