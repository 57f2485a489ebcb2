"""Scenes made in Python: consistent mass properties, and immutability."""

from __future__ import annotations

import copy
import pickle
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from rb_dynamics.body.rigid_body import RigidBody
from rb_dynamics.body.state import State
from rb_dynamics.errors import SceneError, WrenchError
from rb_dynamics.loads.central_gravity import CentralGravity
from rb_dynamics.loads.reaction_wheel import ReactionWheel
from rb_dynamics.loads.scheduled_wrench import ScheduledWrench
from rb_dynamics.loads.uniform_gravity import UniformGravity
from rb_dynamics.loads.wrench import FixedFrame, Wrench, WrenchFrames
from rb_dynamics.loads.wrench_channels import Channel
from rb_dynamics.run.plan import Plan
from rb_dynamics.run.simulate import simulate
from rb_dynamics.scene.model import Scene, Solver
from rb_dynamics.scene.read import parse_scene
from rb_dynamics.sinks.memory_sink import MemorySink

OTHER = RigidBody.from_diagonal(1.0, (1.0, 1.0, 1.0), (0.0, 0.5, 0.0))
READ = parse_scene(
    "body: {mass: 1, inertia: {diagonal: [1, 1, 1]}, frames: {nozzle: {position: [0, 1, 0]}}}\nduration: 1.0"
)
FIXED = {"nozzle": FixedFrame((0.0, 1.0, 0.0))}
# p - c = (0, 0.5, 0): this force turns OTHER by -0.5 rad/s in 1 s.
PUSH = [("wrench", Wrench((1.0, 0.0, 0.0), frame_id="nozzle"))]


@pytest.mark.parametrize(
    "scene",
    [
        replace(READ, body=OTHER),
        pickle.loads(pickle.dumps(replace(READ, body=OTHER))),
        replace(copy.deepcopy(READ), body=OTHER),
        Scene(OTHER, WrenchFrames(fixed=FIXED), State(), duration=1.0),
        Scene(OTHER, READ.frames, State(), duration=1.0),
        Scene(OTHER, WrenchFrames(fixed=FIXED, center_of_mass=(0.0, 0.5, 0.0)), State(), duration=1.0),
    ],
)
def test_lever_arms_are_those_of_the_body(scene: Scene) -> None:
    assert scene.frames.center_of_mass == (0.0, 0.5, 0.0)
    assert simulate(scene, PUSH).sample.angular_velocity_body == pytest.approx((0.0, 0.0, -0.5), abs=1e-12)


@pytest.mark.parametrize(
    "scene",
    [
        replace(READ, body=RigidBody.particle(1.0)),
        Scene(RigidBody.particle(1.0), WrenchFrames(), State(), duration=1.0),
    ],
)
def test_a_torque_on_a_particle_is_rejected(scene: Scene) -> None:
    result = simulate(scene, [("wrench", Wrench(torque=(0.0, 0.0, 1.0)))])

    assert "particle" in result.rejected[0]
    assert result.sample.angular_velocity_body == (0.0, 0.0, 0.0)
    with pytest.raises(WrenchError, match="particle"):
        scene.frames.hold(Wrench(torque=(1.0, 0.0, 0.0)))
    # And a body that turns takes its place.
    assert not simulate(replace(scene, body=OTHER), [("wrench", Wrench(torque=(0.0, 0.0, 1.0)))]).rejected


@pytest.mark.parametrize(
    ("frames", "named"),
    [
        (WrenchFrames(center_of_mass=(0.0, 0.0, 0.0)), "frames.center_of_mass is (0.0, 0.0, 0.0), expected (0.0, 0.5"),
        (WrenchFrames(turns=False), "frames.turns is False, expected True"),
        (replace(READ.frames, fixed={}), "frames.center_of_mass is (0.0, 0.0, 0.0), expected (0.0, 0.5"),
    ],
)
def test_frames_that_contradict_the_body_are_refused(frames: WrenchFrames, named: str) -> None:
    with pytest.raises(SceneError) as error:
        Scene(OTHER, frames, State())

    assert named in str(error.value)
    assert "leave it out" in str(error.value)


def test_frames_are_not_changed_from_outside() -> None:
    fixed = dict(FIXED)
    frames = WrenchFrames(fixed=fixed)
    fixed["nozzle"] = FixedFrame((0.0, 9.0, 0.0))

    assert frames.fixed == FIXED


def test_weight_acts_in_the_world_of_the_scene() -> None:
    """For any name of the world frame, and for an effect taken from another scene."""
    here = Scene(OTHER, WrenchFrames(), State(), duration=1.0, effects=(UniformGravity((0.0, 0.0, -2.0)),))
    there = replace(here, frames=WrenchFrames("inertial", "world"))
    sink = MemorySink()

    assert simulate(there, sinks=[sink]).sample == simulate(here).sample
    assert simulate(here).sample.position_world == pytest.approx((0.0, 0.0, -1.0), abs=1e-12)
    assert [wrench.frame_id for _, entries in there.combined_effects.schedules() for _, wrench in entries] == [
        "inertial"
    ]
    assert "nothing turns the body" in Plan(replace(there, channels=())).description


@pytest.mark.parametrize(
    "frames",
    [
        {"world_frame": "a", "body_frame": "a"},
        {"world_frame": ""},
        {"world_frame": "/map"},
        {"fixed": {"world": FixedFrame()}},
        {"fixed": {"body": FixedFrame()}},
        {"fixed": {"": FixedFrame()}},
    ],
)
def test_no_name_stands_for_two_frames(frames: dict[str, Any]) -> None:
    with pytest.raises(SceneError, match="expected names that differ"):
        WrenchFrames(**frames)


def test_no_topic_stands_for_two_channels() -> None:
    with pytest.raises(SceneError, match="expected different ones"):
        replace(READ, channels=(Channel("push"), Channel("/push", max_force=1.0)))


@pytest.mark.parametrize("topic", ["effects/uniform_gravity", "/effects/a", "pose", "/tf_static", "a/applied", "a b"])
def test_a_topic_that_no_log_could_hold_is_refused(topic: str) -> None:
    with pytest.raises(SceneError, match=f"the topic of a channel is '{topic}', expected a .*topic"):
        replace(READ, channels=(Channel(topic),))


def test_a_scene_keeps_plain_floats() -> None:
    """32-bit numbers would compute in 32 bits, and a timeout would end at a different nanosecond."""
    single: Any = np.float32(0.1)
    scene = replace(
        READ, duration=single, output_rate=single, channels=(Channel(timeout=single),), solver=Solver("rk4", single)
    )

    numbers = (scene.duration, scene.output_rate, scene.channels[0].timeout, scene.solver.step)
    assert {(type(number), number) for number in numbers} == {(float, float(single))}


@pytest.mark.parametrize("given", ["false", 0.0, None])
def test_what_python_alone_takes_for_a_truth_value_is_refused(given: Any) -> None:
    for make in (lambda: Channel(optional=given), lambda: CentralGravity(1.0, gravity_gradient=given)):
        with pytest.raises(TypeError, match="expected a truth value"):
            make()

    numpy_true: Any = np.True_
    assert CentralGravity(1.0, gravity_gradient=numpy_true).gravity_gradient is True


def test_what_a_schedule_was_made_of_may_change_or_run_dry() -> None:
    force: Any = iter((1.0, 0.0, 0.0))
    entries: Any = [(0.0, Wrench(force))]
    effects = ScheduledWrench(entries), ScheduledWrench(iter(entries))  # type: ignore[arg-type]
    entries.clear()

    assert effects == 2 * (ScheduledWrench(((0.0, Wrench((1.0, 0.0, 0.0))),)),)


def test_a_run_begins_at_time_0() -> None:
    with pytest.raises(SceneError, match=r"initial\.time_ns is 5, expected 0: a run begins at time 0"):
        replace(READ, initial=State(5))


def test_with_other_numbers_a_scene_is_as_replaced() -> None:
    scene = replace(READ, effects=(CentralGravity(gravitational_parameter=1.0),), text="text")
    state = State(position_world=(2.0, 0.0, 0.0), orientation_xyzw=(0.0, 0.6, 0.0, 0.8))
    assert scene.combined_effects.body is READ.body
    found = scene.with_numbers(OTHER, state, 5)
    assert found == replace(scene, body=OTHER, initial=state, seed=5, text="")
    assert found.combined_effects.body is OTHER
    assert found.frames.center_of_mass == OTHER.center_of_mass
    assert scene.combined_effects.body is READ.body


@pytest.mark.parametrize(
    ("change", "error"),
    [
        ({"seed": -1}, SceneError),
        ({"initial": State(angular_velocity_body=(np.nan, 0.0, 0.0))}, ValueError),
        ({"initial": State(orientation_xyzw=(1.0, 0.0, 0.0, 1.0))}, ValueError),
        ({"body": RigidBody.from_diagonal(1.0, (0.1, 0.1, 0.1))}, SceneError),
    ],
    ids=["seed", "not finite", "attitude", "smaller than its wheel"],
)
def test_other_numbers_of_a_scene_are_checked(change: dict[str, Any], error: type[Exception]) -> None:
    scene = replace(READ, actuators=(ReactionWheel(name="wheel", axis=(1.0, 0.0, 0.0), inertia=0.5),))
    with pytest.raises(error):
        scene.with_numbers(**({"body": OTHER, "initial": State(), "seed": 1} | change))
