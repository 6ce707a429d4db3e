"""Tools and contact search: FCL collision with the triangles near each tool."""
