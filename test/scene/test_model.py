"""A scene made in Python: one truth for what the body says, and nothing of it changes behind its back."""

from __future__ import annotations

import copy
import pickle
from dataclasses import replace

import pytest

from rb_dynamics.body.rigid_body import RigidBody
from rb_dynamics.body.state import State
from rb_dynamics.errors import SceneError, WrenchError
from rb_dynamics.loads.wrench import FixedFrame, Wrench, WrenchFrames
from rb_dynamics.run.simulation import simulate
from rb_dynamics.scene.model import Scene
from rb_dynamics.scene.read import parse_scene

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
