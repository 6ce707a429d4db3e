"""Tools and where they may touch the organ: FCL collision on the triangles under each tool."""
