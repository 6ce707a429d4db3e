"""Triangle meshes as users have them: reading, repairing or refusing, and voxels of what they enclose."""
