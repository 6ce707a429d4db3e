"""What a scripted bridge can do."""

from collections.abc import Sequence

from tissue_sim.errors import UserError

ACTIONS = ("stroke", "poke", "nip", "grip")
SCRIPT = ACTIONS[:3]  # what needs no gripper


def check(script: Sequence[str], tools: Sequence[str] | None) -> None:
    """Raise UserError for an action that is unknown, or that these tools, where they are known, are too few for."""
    for action in script:
        if action not in ACTIONS:
            raise UserError(f"action '{action}' is unknown; choose from {', '.join(ACTIONS)}")
    if not script:
        raise UserError(f"the script is empty; choose from {', '.join(ACTIONS)}")
    if tools is None:
        return
    if not tools or len(set(tools)) != len(tools):
        raise UserError("name at least one tool, each once")
    if "nip" in script and len(tools) < 2:
        raise UserError("action nip needs two tools: name two with --tools, or leave it out of --script")
