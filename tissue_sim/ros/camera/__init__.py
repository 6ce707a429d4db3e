"""An endoscope: pictures of a running node's organs and tools, as images over ROS 2."""
