"""The node: parameters to topics, the physics loop, contact search, and its reports."""
