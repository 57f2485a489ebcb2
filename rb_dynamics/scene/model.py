"""`Scene`: a validated scene as values. Never reads a file: `scene/read.py` does."""

from __future__ import annotations

from dataclasses import dataclass, field

from rb_dynamics.body.doctor import Finding
from rb_dynamics.body.rigid_body import RigidBody
from rb_dynamics.body.state import State
from rb_dynamics.loads.acting import ActingEffects
from rb_dynamics.loads.channels import Channel
from rb_dynamics.loads.effect import Effect
from rb_dynamics.loads.wrench import WrenchFrames


@dataclass(frozen=True, slots=True)
class Solver:
    """How the motion is computed: a method by name with a `step` (s), or with an `accuracy` that sets the step."""

    method: str = "auto"
    step: float | None = None
    accuracy: float | None = 1.0e-9


@dataclass(frozen=True)
class Scene:
    """A scene, validated and in SI units.

    Attributes:
        body: mass properties.
        frames: names of world and body, fixed frames and the wrench rule.
        initial: state at time 0.
        channels: wrench channels, in the order of the scene.
        solver: method and step or accuracy.
        duration: s, or None where the run has no end of its own.
        output_rate: Hz of published and logged states; 0 for every step.
        text: the scene as YAML, as read; where values were overridden, with those in it; where a file says what the
            body is (mesh, URDF), with what it says. It alone makes this scene.
        source: file name, for messages.
        effects: what acts beside the wrenches, in the order of the scene.
        findings: what was suspicious about the body as it was read; not part of what the scene is.
        surface: file of the mesh that the body is, and its unit in m, for pictures; not part of what the scene is.
    """

    body: RigidBody
    frames: WrenchFrames
    initial: State
    channels: tuple[Channel, ...] = (Channel(),)
    solver: Solver = Solver()
    duration: float | None = None
    output_rate: float = 100.0
    text: str = ""
    source: str = "<scene>"
    effects: tuple[Effect, ...] = ()
    findings: tuple[Finding, ...] = field(default=(), compare=False)
    surface: tuple[str, float] | None = field(default=None, compare=False)

    @property
    def acting(self) -> ActingEffects:
        """What the effects do to the body."""
        return ActingEffects(self.body, self.effects)


__all__ = ["Channel", "Scene", "Solver"]
