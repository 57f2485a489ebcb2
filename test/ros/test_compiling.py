"""What a node compiles, and when: before time runs, for a body must not be held up for seconds."""

from __future__ import annotations

import os
from importlib.util import find_spec

import pytest

from rb_dynamics import Simulation, Wrench, parse_scene
from rb_dynamics.motion import fixed_step_kernel
from rb_dynamics.motion.fixed_step_kernel import Tally, counted_by
from rb_dynamics.ros import node
from rb_dynamics.scene.model import Scene

pytestmark = [pytest.mark.ros, pytest.mark.skipif(find_spec("numba") is None, reason="needs numba (extra 'fast')")]


def scene_with(solver: str) -> Scene:
    return parse_scene(f"""
body: {{mass: 2.0, inertia: {{diagonal: [1, 2, 2.5]}}}}
initial: {{angular_velocity_body: [0.3, -0.2, 0.1]}}
wrenches: [{{topic: wrench}}]
solver: {{{solver}}}
output_rate: 1000
""")


@pytest.mark.parametrize("solver", ["method: rkmk4, step: 0.001", "method: auto"])
def test_nothing_is_compiled_once_time_runs(monkeypatch: pytest.MonkeyPatch, solver: str) -> None:
    """Falling behind once made a node compile what computes many outputs at once, and stand still for 6 s."""
    scene = scene_with(solver)
    monkeypatch.setenv("RB_DYNAMICS_COMPILE", "always")
    with counted_by(tally := Tally()):
        node._warm_up(scene)
        before = set(tally.used)
        node._time_begins()
        monkeypatch.setattr(fixed_step_kernel, "is_cached", lambda _: False)
        simulation = Simulation(scene)
        simulation.post("wrench", Wrench(force=(1.0, 2.0, 3.0), torque=(0.1, 0.2, 0.3)), 5_000_000)
        for time_ns in (1_000_000, 2_000_000, 100_000_000):
            simulation.advance(time_ns)

    assert before == tally.used
    assert before
    assert os.environ["RB_DYNAMICS_COMPILE"] == "cached"
