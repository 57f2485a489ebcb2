"""From a scene to what runs: the method and the control of its step."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

from rb_dynamics.errors import SceneError
from rb_dynamics.motion import METHODS, Method
from rb_dynamics.motion.phase import inertia_of
from rb_dynamics.motion.step_control import AccuracyControl, FixedStep, StepControl
from rb_dynamics.scene.model import Scene

AUTO = "rkmk4"
"""What `method: auto` stands for."""

OPEN_END_HORIZON = 3600.0
"""The time (s) over which `accuracy` is kept where a scene has no duration."""


@dataclass(frozen=True)
class Plan:
    """What a scene is run with; `control` makes a fresh step control for each run."""

    method: Method
    control: Callable[[], StepControl]
    description: str


def compile_scene(scene: Scene) -> Plan:
    """Return the method and the step control that `scene.solver` asks for.

    Raises:
        SceneError: a scene made in Python, not read from a file, asks for what cannot be run.
    """
    _check(scene)
    solver = scene.solver
    method = METHODS[AUTO if solver.method == "auto" else solver.method]
    if solver.step is not None:
        step = solver.step
        return Plan(method, lambda: FixedStep(step), f"{method.name}, step {step!r} s")
    accuracy = 1e-9 if solver.accuracy is None else solver.accuracy
    horizon = scene.duration or OPEN_END_HORIZON
    inertia = inertia_of(scene.body)
    return Plan(
        method,
        lambda: AccuracyControl(accuracy, horizon, method.order, inertia),
        f"{method.name}, steps for an accuracy of {accuracy!r} after {horizon!r} s",
    )


def _check(scene: Scene) -> None:
    """Refuse what would never end; `scene.read` has refused it already in a file, with the line."""
    solver = scene.solver
    if solver.method != "auto" and solver.method not in METHODS:
        raise SceneError(f"{scene.source}: solver.method is {solver.method!r}, expected auto or one of {list(METHODS)}")
    for name, value in (("step", solver.step), ("accuracy", solver.accuracy)):
        if value is not None and not (math.isfinite(value) and value > 0.0):
            raise SceneError(f"{scene.source}: solver.{name} is {value!r}, expected a finite number greater than 0")
    for name, value in (("duration", scene.duration), ("output_rate", scene.output_rate)):
        if value is not None and not (math.isfinite(value) and value >= 0.0):
            raise SceneError(f"{scene.source}: {name} is {value!r}, expected a finite number of at least 0")
