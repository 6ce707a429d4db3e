"""The fixed-rate loop, and the mailboxes between it and Python."""
