"""Actions of a scripted bridge."""

from collections.abc import Sequence

from tissue_sim.errors import UserError

ACTIONS = ("stroke", "poke", "nip", "grip")
SCRIPT = ACTIONS[:3]  # these need no gripper


def check(script: Sequence[str], tools: Sequence[str] | None) -> None:
    """Check that a script's actions are known and that there are enough tools for them.

    script: the actions; tools: names of the tools, if known. Raises UserError when one is unknown, or the tools are too
    few.
    """
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
