"""Pictures of organs and tools: off-screen with OpenGL, as an endoscope would show them, and in a browser."""
