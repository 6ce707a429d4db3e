"""Triangle meshes as people have them: reading, repairing or refusing, and voxels of what they enclose."""
