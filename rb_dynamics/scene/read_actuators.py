"""Read the `actuators` section of a scene. Each type reads its own values."""

from __future__ import annotations

from rb_dynamics.body.rigid_body import RigidBody
from rb_dynamics.errors import SceneError
from rb_dynamics.loads.actuator import COMMAND, Actuator
from rb_dynamics.loads.actuator_types import ACTUATORS
from rb_dynamics.loads.wrench import WrenchFrames
from rb_dynamics.scene.fields import Field
from rb_dynamics.scene.read_channels import topic_in
from rb_dynamics.scene.read_effects import kind_of
from rb_dynamics.scene.scene_entry import SceneEntry


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
    if field is None:
        return ()
    found = []
    for entry in field.items("a list of actuators", "write a list such as [{type: thruster, name: jet_1, ...}], or []"):
        kind = kind_of(entry, ACTUATORS, "an actuator")
        if kind is None:
            continue
        before = entry.problems.count
        values = entry.section(("type", *kind.keys))
        # The name alone too: what a thruster does is told on `<name>/applied`.
        if topic_in(values, "name", kind.kind, taken):
            topic_in(values, "name", kind.kind, taken, COMMAND)
        if kind.needs_field and not magnetic:
            entry.reject("a scene with a magnetic field", "add {type: magnetic_field, ...} to effects")
        try:
            actuator = kind.read(SceneEntry(values, body, frames))
            if entry.problems.count == before and body is not None:
                actuator.check(body)
            found.append(actuator)
        except SceneError as error:
            if entry.problems.count == before:
                entry.reject("an actuator that can be built", str(error))
    return tuple(each for each in found if isinstance(each, Actuator))
