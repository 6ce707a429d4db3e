"""Pictures of organs and tools as an endoscope would show them, drawn off-screen with OpenGL; without ROS."""
