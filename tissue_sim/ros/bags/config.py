"""Required contents of a bag's configuration: a replay builds its simulation and tools from it."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from typing import TypeGuard

from tissue_sim.json_types import JsonObject

_LARGEST = 1e15
_LONGEST = 4096  # characters of a name or path

Fits = Callable[[object], bool]


def read_config(text: str) -> JsonObject:
    """Return a bag's configuration from its JSON, checked as far as every format has it.

    Raises ValueError when it is not JSON.
    """
    config = json.loads(text)
    if not isinstance(config, dict):
        raise ValueError("its configuration is not an object")
    _check(config, "", {"format": _is_whole, "package_version": _is_name})
    return config


def check_config(config: JsonObject) -> None:
    """Check that a configuration of the present format has every value, each of its type.

    Raises ValueError when a value is missing or of another type; the message names it.
    """
    wanted: dict[str, Fits] = {"scene": _is_name, "organs": _is_filled} if "organs" in config else {"organ": _is_object}
    wanted |= {"parameters": _is_object, "shape_gravity": _is_vector}
    wanted |= {"tools": _is_names, "topics": _is_object, "first": _is_object}
    _check(config, "", wanted)
    for name, organ in organs_of(config).items():
        where = f"organs.{name}" if "organs" in config else "organ"
        if not _is_object(organ):
            raise ValueError(f"its configuration's '{where}' is of another type")
        _check(organ, f"{where}.", {"name": _is_name, "digest": _is_name})
    _check(config["topics"], "topics.", dict.fromkeys(config["topics"], _is_name))
    _check(config["first"], "first.", dict.fromkeys(config["first"], _is_whole))
    parameters = config["parameters"]
    of_tool: dict[str, Fits] = {"shape": _is_name, "radius": _is_number, "length": _is_number, "mesh": _is_name}
    chosen: dict[str, Fits] = {"rate": _is_rate, "model": _is_name, "local_region": _is_name}
    chosen |= {name: _is_name for name in ("integrator", "return_target") if name in parameters}
    for tool in config["tools"]:
        chosen |= {f"{tool}.{name}": fits for name, fits in of_tool.items()}
        # Bags from before these parameters lack them.
        later: dict[str, Fits] = {"smoothing": _is_number, "links": _is_names}
        later |= {"tip_link": _is_name, "jaw_joint": _is_name}
        later |= {"height": _is_number, "cautery_speed": _is_number}
        later |= {"cautery_stiffening": _is_number, "cautery_spread": _is_number}
        chosen |= {f"{tool}.{name}": fits for name, fits in later.items() if f"{tool}.{name}" in parameters}
    _check(parameters, "parameters.", chosen)
    if parameters.get("return_target", "rest") != "rest":
        raise ValueError("its return springs follow the skeleton, which this version's don't do; record it again")


def organs_of(config: JsonObject) -> JsonObject:
    """Return what a bag says of its organs, by the names that a scene gives them, or one that is empty."""
    return dict(config["organs"]) if "organs" in config else {"": config["organ"]}


def _check(values: JsonObject, where: str, wanted: Mapping[str, Fits]) -> None:
    for name, fits in wanted.items():
        if name not in values:
            raise ValueError(f"its configuration has no '{where}{name}'")
        if not fits(values[name]):
            raise ValueError(f"its configuration's '{where}{name}' is of another type")


def _is_object(value: object) -> bool:
    return isinstance(value, dict)


def _is_filled(value: object) -> bool:
    return isinstance(value, dict) and len(value) > 0


def _is_name(value: object) -> bool:
    return isinstance(value, str) and len(value) <= _LONGEST and (not value or value.isprintable())


def _is_whole(value: object) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and abs(value) < 2**62


def _is_number(value: object) -> TypeGuard[float]:
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) <= _LARGEST


def _is_rate(value: object) -> bool:
    return _is_number(value) and value > 0


def _is_vector(value: object) -> bool:
    return isinstance(value, list) and len(value) == 3 and all(map(_is_number, value))


def _is_names(value: object) -> bool:
    return isinstance(value, list) and all(map(_is_name, value)) and len(set(value)) == len(value)
