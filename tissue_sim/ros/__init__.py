"""What runs as programs, mostly over ROS 2: the node, its viewer and bridge, and recorded bags."""
