"""The node's part of simulation_interfaces, services that control simulators, where that is installed.

Names, states and result codes are those of its definitions: https://github.com/ros-simulation/simulation_interfaces
"""

from __future__ import annotations

import re
from typing import Protocol

from geometry_msgs.msg import Vector3

from tissue_sim.errors import UserError, shown
from tissue_sim.ros.node.input.tool_input import Refused
from tissue_sim.ros.node.services.entities import Entities, Placed, Sphere
from tissue_sim.ros.node.services.pausing import BY_CLOCK, NEXT_TICK, Pausing, step_result
from tissue_sim.ros.node.shared.deferred_service import DeferredService, Work
from tissue_sim.ros.node.shared.guarded_node import GuardedNode
from tissue_sim.ros.shared.frames import UnknownFrame
from tissue_sim.ros.shared.loop import Loop
from tissue_sim.version import __version__

try:
    from simulation_interfaces.msg import Bounds, Result, SimulationState, SimulatorFeatures
    from simulation_interfaces.srv import (
        GetEntities,
        GetEntityState,
        GetSimulationState,
        GetSimulatorFeatures,
        ResetSimulation,
        SetEntityState,
        SetSimulationState,
        StepSimulation,
    )
except ImportError:
    Result = None

SERVICES = (
    *("get_entities", "get_entity_state", "get_simulation_state", "get_simulator_features"),
    *("reset_simulation", "set_entity_state", "set_simulation_state", "step_simulation"),
)
INFO = (
    f"tissue_sim {__version__}: a step is a tick. Entities are the organs and the tools; twist and"
    " acceleration are always zero. Setting a tool's state acts like a pose of its bridge, which becomes stale"
    " after stale_time. A reset returns the organs to rest."
)


class Answer(Protocol):
    """Response of a service, with its result."""

    result: Result


def installed() -> bool:
    """Return whether the package simulation_interfaces is there."""
    return Result is not None


class SimulationServices:
    """The services, below the node's name; make one only where the package is installed."""

    def __init__(self, node: GuardedNode, loop: Loop, pausing: Pausing, entities: Entities) -> None:
        self._loop, self._pausing, self._entities = loop, pausing, entities
        self._clock = node.get_clock()
        node.create_service(GetEntities, "~/get_entities", self._get_entities)
        node.create_service(GetEntityState, "~/get_entity_state", self._get_entity_state)
        node.create_service(GetSimulationState, "~/get_simulation_state", self._get_state)
        node.create_service(GetSimulatorFeatures, "~/get_simulator_features", self._get_features)
        node.create_service(ResetSimulation, "~/reset_simulation", self._reset)
        node.create_service(SetEntityState, "~/set_entity_state", self._set_entity_state)
        node.create_service(SetSimulationState, "~/set_simulation_state", self._set_state)
        DeferredService(node, StepSimulation, "~/step_simulation", self._step)

    # the simulation ----------------------------------------------------------------------------
    def _get_features(
        self, _: GetSimulatorFeatures.Request, response: GetSimulatorFeatures.Response
    ) -> GetSimulatorFeatures.Response:
        of = SimulatorFeatures
        features = [of.ENTITY_STATE_GETTING, of.ENTITY_STATE_SETTING, of.SIMULATION_RESET, of.SIMULATION_RESET_STATE]
        features.append(of.SIMULATION_STATE_GETTING)
        if self._pausing.possible:
            features += [of.SIMULATION_STATE_SETTING, of.SIMULATION_STATE_PAUSE]
            features += [of.STEP_SIMULATION_SINGLE, of.STEP_SIMULATION_MULTIPLE]
        response.features = SimulatorFeatures(features=features, custom_info=INFO)
        return response

    def _reset(self, request: ResetSimulation.Request, response: ResetSimulation.Response) -> ResetSimulation.Response:
        if request.scope != ResetSimulation.Request.SCOPE_STATE:
            scopes = f"scope {request.scope} includes more than SCOPE_STATE ({ResetSimulation.Request.SCOPE_STATE})"
            why = "ticks follow the machine's time or /clock, and no entity is ever spawned"
            return _answered(response, Result.RESULT_FEATURE_UNSUPPORTED, f"{scopes}: {why}")
        self._loop.reset()
        return _answered(response, Result.RESULT_OK, NEXT_TICK if self._pausing.paused else "")

    def _state(self) -> int:
        if self._pausing.stopped:
            return int(SimulationState.STATE_STOPPED)
        return int(SimulationState.STATE_PAUSED if self._loop.standing else SimulationState.STATE_PLAYING)

    def _get_state(
        self, _: GetSimulationState.Request, response: GetSimulationState.Response
    ) -> GetSimulationState.Response:
        response.state.state = self._state()
        return _answered(response, Result.RESULT_OK)

    def _set_state(
        self, request: SetSimulationState.Request, response: SetSimulationState.Response
    ) -> SetSimulationState.Response:
        target, of, codes = request.state.state, SimulationState, SetSimulationState.Response
        if target == self._state():
            return _answered(response, codes.ALREADY_IN_TARGET_STATE, "it is in that state already")
        changes = {
            of.STATE_STOPPED: self._pausing.stop,
            of.STATE_PLAYING: self._pausing.resume,
            of.STATE_PAUSED: self._pausing.pause,
        }
        if target not in changes:
            line = f"state {target} can't be set: stopped, playing and paused can, and SIGINT ends the node"
            return _answered(response, Result.RESULT_FEATURE_UNSUPPORTED, line)
        if not self._pausing.possible:
            return _answered(response, Result.RESULT_FEATURE_UNSUPPORTED, BY_CLOCK)
        try:
            changes[target]()
        except TimeoutError as error:
            return _answered(response, codes.STATE_TRANSITION_ERROR, str(error))
        return _answered(response, Result.RESULT_OK)

    def _step(self, request: StepSimulation.Request, response: StepSimulation.Response) -> Work | None:
        ticks = int(request.steps)
        if not self._pausing.possible:
            _answered(response, Result.RESULT_FEATURE_UNSUPPORTED, BY_CLOCK)
            return None
        try:
            if self._pausing.stopped:
                raise UserError(
                    "the simulation is stopped, but only a paused one can be stepped: set STATE_PAUSED first"
                )
            self._pausing.begin_step()
        except UserError as error:
            _answered(response, Result.RESULT_OPERATION_FAILED, str(error))
            return None

        def work() -> None:
            done, line = step_result(self._pausing, ticks)
            _answered(response, Result.RESULT_OK if done else Result.RESULT_OPERATION_FAILED, "" if done else line)

        return work

    # entities ----------------------------------------------------------------------------------
    def _get_entities(self, request: GetEntities.Request, response: GetEntities.Response) -> GetEntities.Response:
        filters = request.filters
        for what, asked in (("categories", filters.categories), ("tags", filters.tags.tags)):
            if asked:
                return _answered(response, Result.RESULT_FEATURE_UNSUPPORTED, f"entities have no {what}")
        if filters.bounds.type not in (Bounds.TYPE_EMPTY, Bounds.TYPE_SPHERE):
            line = f"bounds of type {filters.bounds.type} are not supported: only a sphere is"
            return _answered(response, Result.RESULT_FEATURE_UNSUPPORTED, line)
        try:
            pattern, sphere = re.compile(filters.filter), _sphere_of(filters.bounds)
        except re.error as error:
            line = f"the filter '{shown(filters.filter)}' is not a regular expression: {error}"
            return _answered(response, Result.RESULT_OPERATION_FAILED, line)
        except ValueError as error:
            return _answered(response, Result.RESULT_OPERATION_FAILED, str(error))
        named = [name for name in self._entities.names if pattern.search(name)]
        response.entities = [name for name in named if sphere is None or self._entities.meets(name, sphere)]
        return _answered(response, Result.RESULT_OK)

    def _get_entity_state(
        self, request: GetEntityState.Request, response: GetEntityState.Response
    ) -> GetEntityState.Response:
        try:
            frame_id, pose = self._entities.where(request.entity)
        except KeyError:
            return self._unknown(response, request.entity)
        except UserError as error:
            return _answered(response, Result.RESULT_OPERATION_FAILED, str(error))
        state = response.state
        state.header.frame_id, state.header.stamp = frame_id, self._clock.now().to_msg()
        position, turn = state.pose.position, state.pose.orientation
        position.x, position.y, position.z, turn.x, turn.y, turn.z, turn.w = pose
        return _answered(response, Result.RESULT_OK)

    def _set_entity_state(
        self, request: SetEntityState.Request, response: SetEntityState.Response
    ) -> SetEntityState.Response:
        name, state = request.entity, request.state
        if name not in self._entities.names:
            return self._unknown(response, name)
        for is_set, motion, what in (
            (request.set_twist, state.twist, "twist"),
            (request.set_acceleration, state.acceleration, "acceleration"),
        ):
            if is_set and any((*_numbers(motion.linear), *_numbers(motion.angular))):
                line = f"'{name}' is moved by poses only: its {what} can't be set"
                return _answered(response, Result.RESULT_OPERATION_FAILED, line)
        if not request.set_pose:
            return _answered(response, Result.RESULT_OK)
        turn = state.pose.orientation
        pose = (*_numbers(state.pose.position), turn.x, turn.y, turn.z, turn.w)
        try:
            self._entities.place(name, Placed(state.header.frame_id, pose))
        except UnknownFrame as error:
            line = f"frame '{shown(state.header.frame_id)}' is unknown: {error}"
            return _answered(response, Result.RESULT_NOT_FOUND, line)
        except (Refused, ValueError) as error:
            return _answered(response, SetEntityState.Response.INVALID_POSE, f"the pose is refused: {error}")
        except UserError as error:
            return _answered(response, Result.RESULT_OPERATION_FAILED, str(error))
        return _answered(response, Result.RESULT_OK)

    def _unknown[R: Answer](self, response: R, name: str) -> R:
        line = f"there is no entity '{shown(name)}'; choose one of {', '.join(self._entities.names)}"
        return _answered(response, Result.RESULT_NOT_FOUND, line)


def _answered[R: Answer](response: R, code: int, line: str = "") -> R:
    response.result.result, response.result.error_message = code, line
    return response


def _numbers(vector: Vector3) -> tuple[float, float, float]:
    return vector.x, vector.y, vector.z


def _sphere_of(bounds: Bounds) -> Sphere | None:
    """Return the sphere that bounds describe; None where they are empty; raise ValueError for other points."""
    if bounds.type == Bounds.TYPE_EMPTY:
        return None
    if len(bounds.points) != 2 or not bounds.points[1].x >= 0.0:
        raise ValueError("a sphere needs two points: its centre, and one whose x is the radius in m")
    return Sphere(_numbers(bounds.points[0]), bounds.points[1].x)
