"""Services of the package simulation_interfaces, private to the node as in Gazebo, if that package is installed.

Test scripts that control a simulator by this standard can also control the node. The body is the only entity, named
after its frame.
"""

from __future__ import annotations

import math
import re
from typing import Any

from rclpy.action import ActionServer, CancelResponse
from rclpy.action.server import ServerGoalHandle
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.node import Node
from simulation_interfaces.action import SimulateSteps
from simulation_interfaces.msg import EntityCategory, EntityState, Result, SimulationState, SimulatorFeatures
from simulation_interfaces.srv import (
    GetEntities,
    GetEntitiesStates,
    GetEntityInfo,
    GetEntityState,
    GetSimulationState,
    GetSimulatorFeatures,
    ResetSimulation,
    SetEntityState,
    SetSimulationState,
    StepSimulation,
)

from rb_dynamics.errors import RigidBodyError
from rb_dynamics.loads.wrench import frame_name
from rb_dynamics.numerics.rotation import NORM_TOLERANCE
from rb_dynamics.ros import conversions
from rb_dynamics.ros.runner import Runner

_F = SimulatorFeatures
_FEATURES = (
    *(_F.ENTITY_STATE_GETTING, _F.ENTITY_STATE_SETTING, _F.ENTITY_INFO_GETTING),
    *(_F.SIMULATION_RESET, _F.SIMULATION_RESET_TIME, _F.SIMULATION_RESET_STATE),
    *(_F.SIMULATION_STATE_GETTING, _F.SIMULATION_STATE_SETTING, _F.SIMULATION_STATE_PAUSE),
    *(_F.STEP_SIMULATION_SINGLE, _F.STEP_SIMULATION_MULTIPLE, _F.STEP_SIMULATION_ACTION),
)
_ALL_SCOPES = (ResetSimulation.Request.SCOPE_DEFAULT, ResetSimulation.Request.SCOPE_ALL)
_OK = Result(result=Result.RESULT_OK)


class SimulationServices:
    """Answers the standard's requests by means of the node's `Runner`."""

    def __init__(self, node: Node, runner: Runner) -> None:
        """Create the services and the action on `node`."""
        self._runner = runner
        for kind, name, answer in (
            (GetSimulatorFeatures, "get_simulator_features", self._features),
            (GetSimulationState, "get_simulation_state", self._get_simulation_state),
            (SetSimulationState, "set_simulation_state", self._set_simulation_state),
            (StepSimulation, "step_simulation", self._step_simulation),
            (ResetSimulation, "reset_simulation", self._reset),
            (GetEntities, "get_entities", self._entities),
            (GetEntitiesStates, "get_entities_states", self._entities_states),
            (GetEntityInfo, "get_entity_info", self._entity_info),
            (GetEntityState, "get_entity_state", self._get_entity_state),
            (SetEntityState, "set_entity_state", self._set_entity_state),
        ):
            # One group each: a long step must not block ~/pause, commands or a cancellation.
            node.create_service(kind, f"~/{name}", answer, callback_group=MutuallyExclusiveCallbackGroup())
        self._action = ActionServer(
            node,
            SimulateSteps,
            "~/simulate_steps",
            self._simulate_steps,
            cancel_callback=lambda _: CancelResponse.ACCEPT,
            callback_group=MutuallyExclusiveCallbackGroup(),
        )

    def _features(self, _: Any, response: Any) -> Any:
        response.features.features = list(_FEATURES)
        response.features.custom_info = "rb_dynamics: one rigid body; a step is one output period"
        return response

    def _get_simulation_state(self, _: Any, response: Any) -> Any:
        response.state.state, response.result = self._state(), _OK
        return response

    def _set_simulation_state(self, request: Any, response: Any) -> Any:
        wanted, codes = request.state.state, SetSimulationState.Response
        if wanted == self._state():
            response.result = Result(result=codes.ALREADY_IN_TARGET_STATE, error_message="already in that state")
        elif wanted == SimulationState.STATE_STOPPED:
            failure = self._runner.stop()
            code = codes.STATE_TRANSITION_ERROR if failure else Result.RESULT_OK
            response.result = Result(result=code, error_message=failure)
        elif wanted in (SimulationState.STATE_PLAYING, SimulationState.STATE_PAUSED):
            # SimulationState.msg allows stopped -> paused, although the comment of the service does not; it is
            # harmless.
            self._runner.pause(wanted == SimulationState.STATE_PAUSED)
            response.result = _OK
        elif wanted == SimulationState.STATE_QUITTING:
            self._runner.quit()
            response.result = _OK
        else:
            response.result = Result(
                result=codes.INCORRECT_TRANSITION, error_message=f"state {wanted}: there is one world, always loaded"
            )
        return response

    async def _step_simulation(self, request: Any, response: Any) -> Any:
        response.result = self._refusal_to_step() or _outcome(await self._runner.stepped(request.steps))
        return response

    async def _simulate_steps(self, goal: ServerGoalHandle) -> Any:
        refusal = self._refusal_to_step()
        if refusal is not None:
            goal.abort()
            return SimulateSteps.Result(result=refusal)
        for done in range(1, goal.request.steps + 1):
            outcome = _outcome(await self._runner.stepped())
            if outcome.result != Result.RESULT_OK:
                goal.abort()
                return SimulateSteps.Result(result=outcome)
            remaining = goal.request.steps - done
            goal.publish_feedback(SimulateSteps.Feedback(completed_steps=done, remaining_steps=remaining))
            if goal.is_cancel_requested:
                goal.canceled()
                return SimulateSteps.Result(result=_failed(f"cancelled after {done} steps"))
        goal.succeed()
        return SimulateSteps.Result(result=_OK)

    def _reset(self, request: Any, response: Any) -> Any:
        # A bit field in which 0 and 255 mean all; the bit for spawned entities has no effect, as nothing can be
        # spawned.
        kind = ResetSimulation.Request
        scope = kind.SCOPE_ALL if request.scope in _ALL_SCOPES else request.scope
        time, state = bool(scope & kind.SCOPE_TIME), bool(scope & kind.SCOPE_STATE)
        try:
            if time and state:
                failure = self._runner.reset()
                response.result = _outcome(failure)
            elif time or state:
                (self._runner.reset_time if time else self._runner.reset_state)()
                response.result = _OK
            else:
                response.result = Result(
                    result=Result.RESULT_FEATURE_UNSUPPORTED,
                    error_message=f"scope {request.scope}: expected 1 (time), 2 (state), both, or 0 or 255 (all)",
                )
        except RigidBodyError as error:
            response.result = _failed(str(error))
        return response

    def _entities(self, request: Any, response: Any) -> Any:
        response.entities, response.result = self._filtered(request.filters)
        return response

    def _entities_states(self, request: Any, response: Any) -> Any:
        response.entities, response.result = self._filtered(request.filters)
        response.states = [self._entity_state() for _ in response.entities]
        return response

    def _entity_info(self, request: Any, response: Any) -> Any:
        response.result = self._found(request.entity)
        response.info.category.category = EntityCategory.CATEGORY_OBJECT
        response.info.description = f"rigid body of {self._runner.scene.body.mass:g} kg"
        return response

    def _get_entity_state(self, request: Any, response: Any) -> Any:
        response.result = self._found(request.entity)
        if response.result == _OK:
            response.state = self._entity_state()
        return response

    def _set_entity_state(self, request: Any, response: Any) -> Any:
        response.result = self._found(request.entity)
        if response.result != _OK:
            return response
        pose, kind = request.state.pose, SetEntityState.Response
        q, p = pose.orientation, pose.position
        frame = request.state.header.frame_id
        # Before version 2 of the package there was no choice.
        set_pose, set_twist = getattr(request, "set_pose", True), getattr(request, "set_twist", True)
        if frame_name(frame) not in ("", self._runner.scene.frames.world_frame):
            response.result = _failed(
                f"header.frame_id is {frame!r}, expected {self._runner.scene.frames.world_frame!r} or nothing"
            )
        elif set_pose and not (
            abs(math.hypot(q.x, q.y, q.z, q.w) - 1.0) <= NORM_TOLERANCE and all(map(math.isfinite, (p.x, p.y, p.z)))
        ):
            response.result = Result(
                result=kind.INVALID_POSE, error_message="expected a finite position and a unit quaternion"
            )
        else:
            try:
                self._runner.catch_up()
                self._runner.set_state(
                    conversions.with_entity_state(self._runner.state, request.state, set_pose, set_twist)
                )
                self._runner.health.told(f"set_entity_state: moved at {self._runner.shown_time}")
            except RigidBodyError as error:
                response.result = _failed(str(error))
        return response

    def _state(self) -> int:
        if self._runner.stopped:
            return int(SimulationState.STATE_STOPPED)
        return int(SimulationState.STATE_PAUSED if self._runner.paused else SimulationState.STATE_PLAYING)

    def _refusal_to_step(self) -> Result | None:
        return None if self._runner.paused else _failed("only while paused: set_simulation_state to paused first")

    def _filtered(self, filters: Any) -> tuple[list[str], Result]:
        if filters.bounds.points:
            return [], Result(result=Result.RESULT_FEATURE_UNSUPPORTED, error_message="the body has no bounds")
        categories = [category.category for category in filters.categories]
        if filters.tags.tags or (categories and EntityCategory.CATEGORY_OBJECT not in categories):
            return [], _OK
        try:
            return ([self._name] if re.search(filters.filter, self._name) else []), _OK
        except re.error as error:
            return [], _failed(f"filter {filters.filter!r} is no regular expression: {error}")

    def _found(self, entity: str) -> Result:
        if entity == self._name:
            return _OK
        return Result(result=Result.RESULT_NOT_FOUND, error_message=f"no entity {entity!r}, there is {self._name!r}")

    @property
    def _name(self) -> str:
        return self._runner.scene.frames.body_frame

    def _entity_state(self) -> EntityState:
        simulation = self._runner.simulation
        return conversions.entity_state(
            simulation.sample, simulation.acceleration, self._runner.stamp_ns, self._runner.scene.frames
        )


def _outcome(failure: str) -> Result:
    return _failed(failure) if failure else _OK


def _failed(message: str) -> Result:
    return Result(result=Result.RESULT_OPERATION_FAILED, error_message=message)
