"""The parameters of a node: declared with their descriptors, read by name, checked when they change."""

from __future__ import annotations

import array
import difflib
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor, SetParametersResult
from rclpy.exceptions import InvalidParameterTypeException, InvalidParameterValueException
from rclpy.node import Node
from rclpy.parameter import Parameter

from tissue_sim.errors import UserError
from tissue_sim.json_types import JsonObject
from tissue_sim.model.data.settings import Settings
from tissue_sim.ros.shared.parameter_specs import NODE_SPECS, OF_RCLPY, OFF, ORGANS, RENAMED, TOOL_SPECS, Spec
from tissue_sim.ros.shared.parameter_values import check_frames, check_organ_pose


class Parameters:
    """The parameters of a node: declared here, and read by name.

    Raises UserError when a value is out of range or of the wrong type; the message names the parameter.
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self._specs: dict[str, Spec] = {}
        self.changed: list[Callable[[set[str]], None]] = []  # called with the names after a live change
        # Checks of live changes, by name; they raise UserError.
        self.checks: dict[str, Callable[..., object]] = {"organ_pose": partial(check_organ_pose, self)}
        for spec in NODE_SPECS:
            self._declare(spec.name, spec)
        self._declare("tools", Spec("tools", ["left", "right"], "names of the tools"))
        self.tools: list[str] = list(self["tools"])
        for tool in self.tools:
            if not tool.isidentifier() or self.tools.count(tool) > 1:
                raise UserError(f"parameter 'tools': '{tool}' is not a valid or unique name; use letters, digits and _")
            for spec in TOOL_SPECS:
                self._declare(f"{tool}.{spec.name}", spec)
        check_frames(self, self.tools)
        self._warn_of_unknown()
        node.add_pre_set_parameters_callback(lambda given: [self._as_meant(parameter) for parameter in given])
        node.add_on_set_parameters_callback(self._check)
        node.add_post_set_parameters_callback(self._notify)

    def __getitem__(self, name: str) -> Any:
        return self._node.get_parameter(name).value

    @property
    def tf_target(self) -> str:
        """Frame that other frames are looked up against."""
        return self["base_frame"] or self["frame_id"]

    def apply(self, settings: Settings) -> None:
        """Write the parameters that are settings of the simulation into them."""
        for spec in NODE_SPECS:
            if spec.setting:
                setattr(settings, spec.setting, self[spec.name])
        settings.gravity_x, settings.gravity_y, settings.gravity_z = self["gravity"]

    def prefer(self, name: str, value: object) -> None:
        """Give a live parameter another default; a parameter file may contain the old one."""
        if _plain(self[name]) == self._specs[name].default:
            self._node.set_parameters([Parameter(name, value=value)])

    def report_organs(self, names: Sequence[str]) -> None:
        """Declare the read-only parameter with the names of a scene's organs; none for a single one."""
        text = "names of a scene's organs, with which their topics begin; empty for a single organ"
        # Dynamic: rclpy takes an empty list for one of bytes.
        descriptor = ParameterDescriptor(description=text, dynamic_typing=True, read_only=True)
        self._node.declare_parameter(ORGANS, list(names), descriptor, ignore_override=True)
        self._specs[ORGANS] = Spec(ORGANS, list(names), text)

    def values(self) -> JsonObject:
        """Return all parameters by name, as plain values."""
        return {name: _plain(self[name]) for name in self._specs}

    # inside ------------------------------------------------------------------------------------
    def _declare(self, name: str, spec: Spec) -> None:
        descriptor = ParameterDescriptor(description=spec.text, read_only=not spec.live)
        constraints = ["one of " + ", ".join(spec.choices)] if spec.choices else []
        constraints.append("may change while the node runs" if spec.live else "fixed when the node starts")
        descriptor.additional_constraints = "; ".join(constraints)
        if spec.low is not None and spec.high is not None:
            if isinstance(spec.default, int):
                bounds = IntegerRange(from_value=int(spec.low), to_value=int(spec.high), step=1)
                descriptor.integer_range = [bounds]
            else:
                descriptor.floating_point_range = [
                    FloatingPointRange(from_value=spec.low, to_value=spec.high, step=0.0)
                ]
        descriptor.dynamic_typing = OFF in spec.choices  # or rclpy would refuse it before _as_meant
        self._specs[name] = spec
        given = self._node._parameter_overrides.get(name)  # rclpy shows no other way to it
        if given is not None:
            self._node._parameter_overrides[name] = self._as_meant(given)
            if given.type_ == Parameter.Type.NOT_SET and spec.default != [""]:  # rcl reads so an empty list
                raise UserError(f"parameter '{name}' is empty; expected a {_kind_of(spec)}: {spec.text}")
        try:
            self._node.declare_parameter(name, spec.default, descriptor)
        except InvalidParameterTypeException:
            raise UserError(
                f"parameter '{name}' has the wrong type; expected a {_kind_of(spec)}: {spec.text}"
            ) from None
        except InvalidParameterValueException:
            value = given.value if given is not None else "its value"
            raise UserError(
                f"parameter '{name}': {value} is outside {spec.low:g}..{spec.high:g} ({spec.text})"
            ) from None
        if problem := _problem(name, spec, self[name]):
            raise UserError(problem)

    def _warn_of_unknown(self) -> None:
        """Warn about unknown parameters: a misspelt one changes nothing, though a shared file may hold others' too."""
        for name in self._node._parameter_overrides:
            if self._node.has_parameter(name) or name.startswith(OF_RCLPY) or name == ORGANS:
                continue
            tool, _, was = name.partition(".")
            if tool in self.tools and was in RENAMED:
                now = f"{tool}.{RENAMED[was]}"
                self._node.get_logger().warning(
                    f"parameter '{name}' has no effect: its name is now '{now}', {self._specs[now].text}"
                )
                continue
            nearest = difflib.get_close_matches(name, self._specs, 1)
            hint = f"did you mean '{nearest[0]}'?" if nearest else "'tissue_node --help' lists all"
            self._node.get_logger().warning(f"parameter '{name}' is unknown and has no effect; {hint}")

    def _as_meant(self, parameter: Parameter) -> Parameter:
        """Return a parameter as it was meant: false for off, whole numbers for decimals, or none of a list's names."""
        spec = self._specs.get(parameter.name)
        if spec is None:
            return parameter
        if OFF in spec.choices and parameter.value is False:
            return Parameter(parameter.name, value=OFF)
        kind = Parameter.Type
        if parameter.type_ == kind.NOT_SET and spec.default == [""]:
            return Parameter(parameter.name, value=spec.default)
        if isinstance(spec.default, float) and parameter.type_ == kind.INTEGER:
            return Parameter(parameter.name, value=float(parameter.value))
        if _is_decimals(spec.default) and parameter.type_ == kind.INTEGER_ARRAY:
            return Parameter(parameter.name, value=[float(value) for value in parameter.value])
        return parameter

    def decided(self, parameter: Parameter) -> SetParametersResult | None:
        """Return the result of setting a parameter that is fixed; None for one that isn't.

        Its present value is accepted, as in a dump of the node's own that is loaded again; rclpy would refuse it.
        """
        spec = self._specs.get(parameter.name)
        if spec is None or spec.live:
            return None
        if _plain(self._as_meant(parameter).value) == _plain(self[parameter.name]):
            return SetParametersResult(successful=True)
        reason = f"'{parameter.name}' can't change while the node runs; restart the node with the new value"
        if parameter.name == ORGANS:
            reason = f"'{ORGANS}' reports which organs the node serves, and can't be set"
        return SetParametersResult(successful=False, reason=reason)

    def _check(self, parameters: list[Parameter]) -> SetParametersResult:
        """Accept live parameters in range; refuse others with the reason."""
        for parameter in parameters:
            spec = self._specs.get(parameter.name)
            if spec is None:
                continue
            if problem := _problem(parameter.name, spec, parameter.value):
                return SetParametersResult(successful=False, reason=problem)
            try:
                self.checks.get(parameter.name, bool)(parameter.value)
            except UserError as error:
                return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def _notify(self, parameters: list[Parameter]) -> None:
        """Notify the listeners after a change that was not refused."""
        names = {parameter.name for parameter in parameters} & set(self._specs)
        for call in self.changed if names else []:
            call(names)


def _problem(name: str, spec: Spec, value: Any) -> str:
    if spec.choices and value not in spec.choices:
        return f"parameter '{name}': '{value}' is unknown; choose one of {', '.join(spec.choices)}"
    if spec.low is not None and spec.high is not None:
        if not np.isfinite(value) or not spec.low <= value <= spec.high:
            return f"parameter '{name}': {value} is outside {spec.low:g}..{spec.high:g} ({spec.text})"
    if spec.check is not None:
        try:
            spec.check(value)
        except ValueError as error:
            return f"parameter '{name}' {error}"
    return ""


def _kind_of(spec: Spec) -> str:
    """Return the type of a parameter's values in words."""
    kind = type(spec.default).__name__
    return f"list like {spec.default}" if kind == "list" else kind


def _is_decimals(value: object) -> bool:
    """Return whether it is a list of numbers that need not be whole."""
    return isinstance(value, list) and bool(value) and isinstance(value[0], float)


def _plain(value: object) -> object:
    if isinstance(value, Path):
        return str(value)
    return list(value) if isinstance(value, (list, tuple, array.array)) else value
