"""What a node's parameters say to the programs beside it."""

from tissue_sim.ros.shared.parameter_specs import NODE_SPECS, TOOL_SPECS


def values(*tools: str, **given: object) -> dict[str, object]:
    """Those of a node with some tools, `left` unless named, by their defaults but for some: left__shape="gripper"."""
    names = list(tools or ("left",))
    found = {spec.name: spec.default for spec in NODE_SPECS} | {"tools": names}
    found |= {f"{tool}.{spec.name}": spec.default for tool in names for spec in TOOL_SPECS}
    return found | {name.replace("__", "."): value for name, value in given.items()}
