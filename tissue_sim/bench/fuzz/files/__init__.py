"""Files mutated at random: organs, images, meshes, bags."""
