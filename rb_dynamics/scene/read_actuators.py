"""Read the `actuators` section of a scene. Each type reads its own values."""

from __future__ import annotations

from rb_dynamics.body.rigid_body import RigidBody
from rb_dynamics.formats.yaml.fields import Field
from rb_dynamics.loads.actuator import COMMAND, Actuator
from rb_dynamics.loads.actuator_types import ACTUATORS
from rb_dynamics.loads.effect import Effect
from rb_dynamics.loads.scene_entry import SceneEntry
from rb_dynamics.loads.wrench import WrenchFrames
from rb_dynamics.scene.read_channels import topic_in
from rb_dynamics.scene.read_effects import each_entry, require_field


def actuators(
    field: Field | None, body: RigidBody | None, frames: WrenchFrames, magnetic: bool, taken: dict[str, str]
) -> tuple[Actuator, ...]:
    """Return the actuators in the order of the scene, empty if the section is absent; records problems.

    Args:
        field: the section.
        body: None if the scene has no valid one.
        frames: where a thruster may be.
        magnetic: whether the scene has a magnetic field.
        taken: the topics of the scene, each with its key; those of the actuators come into it.
    """

    def read(kind: type[Actuator], entry: Field) -> Effect:
        before = entry.problems.count
        values = entry.section(("type", *kind.keys))
        # The name alone too: what a thruster does is told on `<name>/applied`.
        if topic_in(values, "name", kind.kind, taken):
            topic_in(values, "name", kind.kind, taken, COMMAND)
        require_field(entry, kind.needs_field, magnetic)
        actuator = kind.read(SceneEntry(values, body, frames))
        if entry.problems.count == before and body is not None:
            actuator.check(body)
        return actuator

    found = each_entry(field, ACTUATORS, "an actuator", "{type: thruster, name: jet_1, ...}", "that can be built", read)
    return tuple(each for each in found if isinstance(each, Actuator))
