"""The error of the mesh readers."""


class MeshError(ValueError):
    """A file that doesn't hold what its format requires: its text is for the user, unlike that of libraries' errors."""
