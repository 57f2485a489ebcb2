"""The services of simulation_interfaces, against the real package if installed."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from geometry_msgs.msg import PoseStamped
from rclpy.action import ActionClient
from ros_harness import Peer, running, stamp
from std_srvs.srv import SetBool

pytest.importorskip("simulation_interfaces", reason="simulation_interfaces is not installed: it is not on PyPI")

from simulation_interfaces import srv
from simulation_interfaces.action import SimulateSteps
from simulation_interfaces.msg import Result, SimulationState

pytestmark = pytest.mark.ros

STOPPED, PLAYING, PAUSED = 0, 1, 2


class Simulator:
    """A client of the standard services."""

    def __init__(self, peer: Peer) -> None:
        self.peer = peer

    def call(self, kind: Any, name: str, **fields: Any) -> Any:
        return self.peer.call(f"rigid_body/{name}", kind.Request(**fields), kind)

    def state(self) -> int:
        return int(self.call(srv.GetSimulationState, "get_simulation_state").state.state)

    def set_state(self, state: int) -> int:
        wanted = SimulationState(state=state)
        return int(self.call(srv.SetSimulationState, "set_simulation_state", state=wanted).result.result)

    def entity(self) -> Any:
        return self.call(srv.GetEntityState, "get_entity_state", entity="body").state


@pytest.fixture
def simulator(peer: Peer) -> Simulator:
    return Simulator(peer)


def test_features_and_states(scene: Path, simulator: Simulator) -> None:
    with running(scene) as node:
        features = simulator.call(srv.GetSimulatorFeatures, "get_simulator_features").features
        assert list(features.features) == [10, 11, 12, 20, 21, 22, 24, 25, 26, 31, 32, 33]
        assert simulator.state() == PLAYING
        codes = srv.SetSimulationState.Response
        assert simulator.set_state(PLAYING) == codes.ALREADY_IN_TARGET_STATE
        assert simulator.set_state(PAUSED) == Result.RESULT_OK
        assert simulator.set_state(STOPPED) == Result.RESULT_OK
        assert simulator.state() == STOPPED
        assert simulator.entity().header.stamp.nanosec == 1
        assert simulator.set_state(PAUSED) == Result.RESULT_OK, "SimulationState.msg allows it"
        assert simulator.state() == PAUSED
        assert simulator.set_state(SimulationState.STATE_LOADING_WORLD) == codes.INCORRECT_TRANSITION
        assert simulator.set_state(SimulationState.STATE_QUITTING) == Result.RESULT_OK
        assert node.wait() == 0


def test_steps_only_while_paused_and_the_answer_comes_when_they_are_done(scene: Path, simulator: Simulator) -> None:
    with running(scene) as node:
        answer = simulator.call(srv.StepSimulation, "step_simulation", steps=3)
        assert answer.result.result == Result.RESULT_OPERATION_FAILED
        assert simulator.set_state(PAUSED) == Result.RESULT_OK
        before = simulator.entity()
        assert simulator.call(srv.StepSimulation, "step_simulation", steps=30).result.result == Result.RESULT_OK
        assert stamp(simulator.entity()) - stamp(before) == pytest.approx(300_000_000, abs=10_000_000)
        client = ActionClient(simulator.peer.node, SimulateSteps, "rigid_body/simulate_steps")
        simulator.peer.until(client.server_is_ready, "the action")
        feedback: list[Any] = []
        before = simulator.entity()
        goal = client.send_goal_async(SimulateSteps.Goal(steps=5), lambda m: feedback.append(m.feedback))
        simulator.peer.until(goal.done, "the goal accepted")
        result = goal.result().get_result_async()
        simulator.peer.until(lambda: result.done() and len(feedback) == 5, "the steps done")
        assert result.result().result.result.result == Result.RESULT_OK
        assert [(f.completed_steps, f.remaining_steps) for f in feedback] == [(k, 5 - k) for k in range(1, 6)]
        assert stamp(simulator.entity()) - stamp(before) == 50_000_000
        assert node.stop() == 0


def test_steps_that_are_computed_hold_up_nobody_and_a_pause_or_resume_ends_them(
    scene: Path, simulator: Simulator
) -> None:
    peer = simulator.peer
    with running(scene, start_paused=True, solver__step=1e-5) as node:
        client = peer.node.create_client(srv.StepSimulation, "rigid_body/step_simulation")
        peer.until(client.service_is_ready, "the service")
        poses = peer.listen(PoseStamped, "pose")
        peer.until(lambda: bool(poses), "the greeting")
        # Minutes of work.
        answer = client.call_async(srv.StepSimulation.Request(steps=10_000))
        peer.until(lambda: len(poses) > 2, "motion")
        assert peer.call("rigid_body/pause", SetBool.Request(data=True)).success
        peer.until(answer.done, "the answer")
        assert answer.result().result.result == Result.RESULT_OPERATION_FAILED
        assert "paused or resumed" in answer.result().result.error_message
        action = ActionClient(peer.node, SimulateSteps, "rigid_body/simulate_steps")
        peer.until(action.server_is_ready, "the action")
        goal = action.send_goal_async(SimulateSteps.Goal(steps=10_000))
        peer.until(goal.done, "the goal accepted")
        result = goal.result().get_result_async()
        assert peer.call("rigid_body/pause", SetBool.Request(data=False)).success
        peer.until(result.done, "the result")
        assert result.result().result.result.result == Result.RESULT_OPERATION_FAILED
        assert node.stop() == 0


def test_entities_and_their_state_in_world_axes(scene: Path, simulator: Simulator) -> None:
    with running(scene, start_paused=True) as node:
        assert list(simulator.call(srv.GetEntities, "get_entities").entities) == ["body"]
        assert (
            simulator.call(srv.GetEntityInfo, "get_entity_info", entity="sun").result.result == Result.RESULT_NOT_FOUND
        )
        request = srv.SetEntityState.Request(entity="body", set_pose=True, set_twist=True)
        pose, twist = request.state.pose, request.state.twist
        pose.position.x, pose.orientation.z, pose.orientation.w = 5.0, 0.5**0.5, 0.5**0.5
        twist.linear.x, twist.angular.x = 1.0, 0.25
        answer = simulator.peer.call("rigid_body/set_entity_state", request, srv.SetEntityState)
        assert answer.result.result == Result.RESULT_OK, answer.result.error_message
        now = simulator.entity()
        assert (now.header.frame_id, now.pose.position.x, now.twist.linear.x) == ("world", 5.0, 1.0)
        assert now.twist.angular.x == pytest.approx(0.25, rel=1e-14)
        simulator.call(srv.StepSimulation, "step_simulation", steps=1)
        assert simulator.entity().pose.position.x == pytest.approx(5.01, rel=1e-12)
        pose.orientation.z = 0.0
        answer = simulator.peer.call("rigid_body/set_entity_state", request, srv.SetEntityState)
        assert answer.result.result == srv.SetEntityState.Response.INVALID_POSE
        request.set_pose, request.set_twist = False, False
        request.state.header.frame_id = "map"
        answer = simulator.peer.call("rigid_body/set_entity_state", request, srv.SetEntityState)
        assert answer.result.result == Result.RESULT_OPERATION_FAILED
        assert node.stop() == 0


def test_the_scope_of_a_reset_is_a_bit_field(scene: Path, simulator: Simulator) -> None:
    with running(scene, start_paused=True) as node:
        poses = simulator.peer.listen(PoseStamped, "pose")
        start = simulator.entity()

        def reset(scope: int) -> int:
            return int(simulator.call(srv.ResetSimulation, "reset_simulation", scope=scope).result.result)

        simulator.call(srv.StepSimulation, "step_simulation", steps=10)
        moved = simulator.entity()
        assert reset(1) == Result.RESULT_OK
        assert stamp(simulator.entity()) == 1
        assert simulator.entity().pose == moved.pose
        simulator.call(srv.StepSimulation, "step_simulation", steps=10)
        assert reset(2) == Result.RESULT_OK
        assert stamp(simulator.entity()) == 100_000_000
        assert simulator.entity().pose == start.pose
        assert reset(4) == Result.RESULT_FEATURE_UNSUPPORTED
        for scope in (3, 0, 255):
            simulator.call(srv.StepSimulation, "step_simulation", steps=1)
            assert reset(scope) == Result.RESULT_OK
            assert (stamp(simulator.entity()), simulator.entity().pose) == (1, start.pose)
        assert poses
        assert simulator.peer.call("rigid_body/pause", SetBool.Request(data=True)).success
        assert node.stop() == 0
