"""From a scene to what runs: the method for each arc and the control of its step."""

from __future__ import annotations

import math
from dataclasses import dataclass

from rb_dynamics.errors import SceneError
from rb_dynamics.loads.wrench import HeldWrench
from rb_dynamics.motion import METHODS, Method
from rb_dynamics.motion.exact import EXACT, is_free
from rb_dynamics.motion.phase import inertia_of
from rb_dynamics.motion.step_control import AccuracyControl, FixedStep, OwnControl, StepControl, WholeArc
from rb_dynamics.scene.model import Scene

DRIVEN = "taylor"
"""What `method: auto` takes where something turns the body; where nothing does it takes the exact free motion."""

OPEN_END_HORIZON = 3600.0
"""The time (s) over which `accuracy` is kept where a scene has no duration."""


@dataclass(frozen=True)
class Plan:
    """What a scene is run with.

    Attributes:
        name: of the method; "auto" where it varies along the run.
        method: what moves the body while it is driven.
        control: the control of its step; remembers the step it has found, so each run needs a plan of its own.
        free: what moves the body while it is free.
        free_control: the control of its step.
        description: for a person.
    """

    name: str
    method: Method
    control: StepControl
    free: Method
    free_control: StepControl
    description: str

    def choose(self, held: HeldWrench) -> tuple[Method, StepControl]:
        """Return the method and the step control for an arc under `held`."""
        return (self.free, self.free_control) if is_free(held) else (self.method, self.control)


def compile_scene(scene: Scene) -> Plan:
    """Return the least that `scene.solver` asks for: with `auto`, no step at all where the motion is free.

    Raises:
        SceneError: the solver, the duration or the output rate makes no sense.
    """
    _check(scene)
    auto = scene.solver.method == "auto"
    method = METHODS[DRIVEN if auto else scene.solver.method]
    control, steps = _control(scene, method)
    if not auto:
        return Plan(method.name, method, control, method, control, f"{method.name}, {steps}")
    if not scene.channels:
        return Plan("exact", EXACT, WholeArc(), EXACT, WholeArc(), "auto: exact, as nothing acts on the body")
    description = f"auto: exact where the motion is free; where a wrench turns the body {method.name}, {steps}"
    return Plan("auto", method, control, EXACT, WholeArc(), description)


def _check(scene: Scene) -> None:
    """Refuse what would never end; a scene from a file has been checked with the line at fault, one made in Python not.

    Raises:
        SceneError: names the value, what was expected and the remedy.
    """
    solver = scene.solver
    if solver.method != "auto" and solver.method not in METHODS:
        raise SceneError(f"solver.method is {solver.method!r}, expected auto or one of {sorted(METHODS)}")
    for name, value in (("solver.step", solver.step), ("solver.accuracy", solver.accuracy)):
        if value is not None and not (math.isfinite(value) and value > 0.0):
            raise SceneError(f"{name} is {value!r}, expected a finite number greater than 0")
    for name, value in (("duration", scene.duration), ("output_rate", scene.output_rate)):
        if value is not None and not (math.isfinite(value) and value >= 0.0):
            raise SceneError(f"{name} is {value!r}, expected a finite number of 0 or more")


def _control(scene: Scene, method: Method) -> tuple[StepControl, str]:
    solver = scene.solver
    if method.order is None:
        return WholeArc(), "in closed form"
    if solver.step is not None:
        return FixedStep(solver.step), f"step {solver.step!r} s"
    accuracy = 1e-9 if solver.accuracy is None else solver.accuracy
    horizon = scene.duration or OPEN_END_HORIZON
    description = f"steps for an accuracy of {accuracy!r} after {horizon!r} s"
    if method.longest_step is not None:
        return OwnControl(accuracy, horizon), description
    control = AccuracyControl(accuracy, horizon, method.order, inertia_of(scene.body))
    return control, description
