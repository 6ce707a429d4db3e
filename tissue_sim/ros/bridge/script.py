"""What a scripted bridge can do."""

ACTIONS = ("stroke", "poke", "nip", "grip")
SCRIPT = ACTIONS[:3]  # what needs no gripper
